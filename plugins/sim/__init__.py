"""Simulated robots in one common world."""
