"""EvBotOS: small bootable images whose robots serve their resources at power-on.

YAML files define the images (`platforms/`, `images/`, a user's `local.yaml`). These modules read them, plan
the steps, and execute them with Debian's packages and tools (Source: thesis chapters 3 and 5, appendix A).
"""
