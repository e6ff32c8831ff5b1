"""The EvBot III: two wheels and a turret, over a wireless network."""
