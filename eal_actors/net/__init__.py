"""The network layer: robots served to controllers elsewhere, over zenoh."""
