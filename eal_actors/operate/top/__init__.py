"""`eal top`: a fleet in the terminal."""
