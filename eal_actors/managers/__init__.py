"""The managers of configuration, plugins and resources: plain objects without threads."""
