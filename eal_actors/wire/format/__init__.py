"""Keys, messages and frames: pure functions between objects and bytes."""
