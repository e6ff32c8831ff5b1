"""Later Roombas and the Create 2, driven over their Open Interface."""
