"""EvBotOS: small bootable images whose robots serve their resources when they are switched on.

What an image holds is said in YAML (`platforms/`, `images/`, a user's `local.yaml`); the modules here read it, plan
the steps, and carry them out with Debian's packages and tools (Source: thesis chapters 3 and 5, appendix A).
"""
