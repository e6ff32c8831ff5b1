"""The users' APIs: Fleet for concurrent programs, EAL for synchronous scripts, RobotService for servers."""
