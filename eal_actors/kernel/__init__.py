"""Foundations: the error tree, clocks and timers, logging, spans, strict YAML and models of files."""
