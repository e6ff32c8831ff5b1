"""Records of runs.

Writing: `run_recorder` samples the robots (`sampler`) and listens to the run. It writes poses (`poses`) and `run.mcap`
(`mcap_file`, whose content `messages` and `schemas` define). `provenance` keeps the run's input; `repair` makes the
record of an interrupted run whole. `live_record` records a fleet that others command.

Reading: `run_folder` reads all files of a run, `recorded_run` its values and calls for the replay, and `comparison`
compares two runs.

Showing: `timeline` is the course of a run, `arena`, `picture` and `film` draw, and `report_page` is the HTML page;
`difference_page` is that of two runs.
"""

from eal_actors.recording.arena import draw_world
from eal_actors.recording.comparison import Difference, PathDeviation, compare_runs, first_difference, path_deviations
from eal_actors.recording.difference_page import render_difference
from eal_actors.recording.film import film_run
from eal_actors.recording.live_record import LiveRecord
from eal_actors.recording.picture import draw_run, draw_trajectory
from eal_actors.recording.poses import PoseRecorder, PoseSample
from eal_actors.recording.provenance import keep_provenance, kept_world
from eal_actors.recording.repair import repair_interrupted, repair_record
from eal_actors.recording.report_page import render_report
from eal_actors.recording.run_folder import RunFolder, folder_errors, new_run_folder
from eal_actors.recording.run_recorder import Extent, RepeatedPast, RunRecorder

__all__ = [
    "Difference",
    "Extent",
    "LiveRecord",
    "PathDeviation",
    "PoseRecorder",
    "PoseSample",
    "RepeatedPast",
    "RunFolder",
    "RunRecorder",
    "compare_runs",
    "draw_run",
    "draw_trajectory",
    "draw_world",
    "film_run",
    "first_difference",
    "folder_errors",
    "keep_provenance",
    "kept_world",
    "new_run_folder",
    "path_deviations",
    "render_difference",
    "render_report",
    "repair_interrupted",
    "repair_record",
]
