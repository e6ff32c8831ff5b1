"""AGVs by VDA 5050, and the fleet as AGVs of another master."""
