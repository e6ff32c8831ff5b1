"""Remote calls: the client of a robot and its server, and what both ends use."""
