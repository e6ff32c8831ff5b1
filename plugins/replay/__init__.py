"""A robot of a recorded run, played back."""
