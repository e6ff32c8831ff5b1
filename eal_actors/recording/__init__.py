"""Records of runs: poses and readings while robots work, pictures, the report page, and comparing two runs."""

from eal_actors.recording.arena import draw_world
from eal_actors.recording.continuing import mend_record
from eal_actors.recording.differences import Difference, differences
from eal_actors.recording.picture import draw_trajectory
from eal_actors.recording.pose_sample import PoseSample
from eal_actors.recording.poses import PoseRecorder
from eal_actors.recording.provenance import keep_provenance, kept_world
from eal_actors.recording.report_page import render_report
from eal_actors.recording.run_folder import RunFolder
from eal_actors.recording.run_recorder import Extent, RunRecorder

__all__ = [
    "Difference",
    "Extent",
    "PoseRecorder",
    "PoseSample",
    "RunFolder",
    "RunRecorder",
    "differences",
    "draw_trajectory",
    "draw_world",
    "keep_provenance",
    "kept_world",
    "mend_record",
    "render_report",
]
