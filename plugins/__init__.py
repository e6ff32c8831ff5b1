"""The plugins that come with the framework, one folder each.

At run time a plugin's folder is loaded as the package `eal_plugins.<name>`, so a plugin imports its own modules
relatively, and of the framework only `eal_actors.plugin`.
"""
