"""Carrying out the traffic plans of a fleet: `Fleet.go_to`."""
