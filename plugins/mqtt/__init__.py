"""An MQTT broker: topics as resources, and the connection that other plugins use."""
