"""The Mote Roomba: an iRobot Roomba driven over its Serial Command Interface."""
