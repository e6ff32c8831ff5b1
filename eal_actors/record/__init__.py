"""Records of runs as files: what they hold, how it is written, and how it is read back."""
