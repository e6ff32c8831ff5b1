"""Records of a run beyond its summary: the robots' paths, as a table and as a picture; and pictures of worlds."""

from eal_actors.recording.arena import draw_world
from eal_actors.recording.picture import draw_trajectory
from eal_actors.recording.poses import PoseRecorder, PoseSample
from eal_actors.recording.table import write_trajectory

__all__ = ["PoseRecorder", "PoseSample", "draw_trajectory", "draw_world", "write_trajectory"]
