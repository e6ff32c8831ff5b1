"""Live view of a fleet in Foxglove and Lichtblick, by Foxglove's own server."""

from eal_actors.operate.foxglove.live_view import LiveView

__all__ = ["LiveView"]
