"""`eal top`: a table of a fleet's robots in the terminal."""
