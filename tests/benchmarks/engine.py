"""The scenario engine's own cost per robot and step, with 100 robots whose command returns at once."""
