"""Hands: driving robots with a gamepad or a keyboard of this machine, through Linux's input devices."""

from eal_actors.operate.hands.hand_driver import HandDriver, HandSettings
from eal_actors.operate.hands.input_device import InputSource, find_input

__all__ = ["HandDriver", "HandSettings", "InputSource", "find_input"]
