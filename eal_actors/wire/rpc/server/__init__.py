"""Network of a process that runs robots: calls, admission, leases, commands and streams."""
