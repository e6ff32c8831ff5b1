"""Network of a program that commands robots: connections, calls, streams and discovery."""
