"""Records of a run beyond its summary: the robots' paths, as a table and as a picture."""

from eal_actors.recording.picture import draw_trajectory
from eal_actors.recording.poses import PoseRecorder, PoseSample
from eal_actors.recording.table import write_trajectory

__all__ = ["PoseRecorder", "PoseSample", "draw_trajectory", "write_trajectory"]
