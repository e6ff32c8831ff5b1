"""Bytes that nobody meant, into everything that reads what others wrote. `make fuzz` searches for long."""
