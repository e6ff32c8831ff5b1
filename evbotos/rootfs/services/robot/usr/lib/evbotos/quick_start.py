"""Start the robot's server as quickly as a slow board can.

What only terminals need is not loaded, and what is loaded is not looked through for garbage: on a Cortex-A8, and in an
emulator, both cost seconds.
"""

from __future__ import annotations

import gc
import sys
from importlib import import_module

gc.disable()
sys.modules["rich"] = None  # type: ignore[assignment]  # to Python: not installed; structlog then does without
server = import_module("serve_robot")
gc.freeze()
gc.enable()
server.main()
