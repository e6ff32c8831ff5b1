"""Poses of robots by markers on them and cameras above the floor."""
