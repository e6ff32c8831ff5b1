"""Expressions in `${...}`: parsed and checked when the file is read, evaluated when the step is reached."""
