"""The EvBot II: a tracked base behind a serial line; what it has in common with the EvBot III is here too."""
