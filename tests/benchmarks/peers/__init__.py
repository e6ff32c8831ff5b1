"""The same work through this project and through others, interleaved in one run, on one core: `make bench-peers`."""
