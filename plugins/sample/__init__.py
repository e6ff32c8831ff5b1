"""The shortest plugin: one resource that keeps an int."""
