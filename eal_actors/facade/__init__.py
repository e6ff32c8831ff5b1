"""What users hold: Fleet, the concurrent way in, and EAL, the synchronous one."""
