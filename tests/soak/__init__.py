"""A long run under faults: robots and controllers in their own processes. `make soak` runs it."""
