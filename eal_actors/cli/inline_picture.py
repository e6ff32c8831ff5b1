"""Pictures in the terminal: by the protocols of kitty and iTerm2, or as sixels.

Source: kitty's "Terminal graphics protocol"; iTerm2's "Inline Images Protocol"; DEC's VT330/VT340 Programmer Reference
Manual, chapter 14, for sixels.
"""

from __future__ import annotations

import base64
import os
import re
import select
import sys
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

from eal_actors.kernel.posix import HAS_TERMINALS, termios, tty

if TYPE_CHECKING:
    from PIL.Image import Image

_CHUNK: Final = 4096  # bytes of base64 in one message of kitty's protocol
_ANSWER_S: Final = 0.3
_ATTRIBUTES: Final = re.compile(rb"\x1b\[\?([0-9;]*)c")
_SIXEL: Final = b"4"
_COLOURS: Final = 128
_WIDTH_PX: Final = 640


def show_inline(out: IO[str], picture: Path, film: Path | None = None) -> bool:
    """Show a PNG file in the terminal, or a GIF film where it plays; return False if the terminal shows no pictures."""
    if not out.isatty():
        return False
    if os.environ.get("KITTY_WINDOW_ID") or os.environ.get("TERM", "") in ("xterm-kitty", "xterm-ghostty"):
        messages = _kitty(picture.read_bytes())
    elif os.environ.get("TERM_PROGRAM") in ("iTerm.app", "WezTerm"):
        messages = iter([_iterm(film or picture)])
    elif _shows_sixels():
        messages = _sixels(picture)
    else:
        return False
    out.writelines(messages)
    out.write("\n")
    out.flush()
    return True


def _kitty(png: bytes) -> Iterator[str]:
    text = base64.b64encode(png).decode()
    parts = [text[place : place + _CHUNK] for place in range(0, len(text), _CHUNK)]
    for number, part in enumerate(parts):
        more = int(number < len(parts) - 1)
        yield f"\x1b_G{'a=T,f=100,' if number == 0 else ''}m={more};{part}\x1b\\"


def _iterm(file: Path) -> str:
    content = file.read_bytes()
    text = base64.b64encode(content).decode()
    return f"\x1b]1337;File=inline=1;size={len(content)};width=auto:{text}\a"


def _shows_sixels() -> bool:
    """Ask the terminal for its attributes: number 4 is sixel graphics."""
    if not HAS_TERMINALS or not sys.stdin.isatty():
        return False
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    answer = b""
    try:
        tty.setcbreak(terminal, termios.TCSANOW)
        os.write(terminal, b"\x1b[c")
        while _ATTRIBUTES.search(answer) is None and select.select([terminal], [], [], _ANSWER_S)[0]:
            if not (part := os.read(terminal, 256)):
                break
            answer += part
    except OSError:  # no terminal that answers
        return False
    finally:
        termios.tcsetattr(terminal, termios.TCSANOW, before)
    found = _ATTRIBUTES.search(answer)
    return found is not None and _SIXEL in found[1].split(b";")


def _sixels(file: Path) -> Iterator[str]:
    """Yield a picture as sixels: bands of six rows, in which each colour is drawn by itself."""
    from PIL import Image

    with Image.open(BytesIO(file.read_bytes())) as opened:
        scale = min(1.0, _WIDTH_PX / opened.width)
        small = opened.convert("RGB").resize((round(opened.width * scale), round(opened.height * scale)))
    picture = small.quantize(_COLOURS)
    yield f'\x1bPq"1;1;{picture.width};{picture.height}'
    palette = picture.getpalette() or []
    for number in range(len(palette) // 3):
        red, green, blue = (round(part * 100 / 255) for part in palette[3 * number : 3 * number + 3])
        yield f"#{number};2;{red};{green};{blue}"
    for top in range(0, picture.height, 6):
        yield _band(picture, top)
    yield "\x1b\\"


def _band(picture: Image, top: int) -> str:
    width, rows = picture.width, min(6, picture.height - top)
    pixels = picture.crop((0, top, width, top + rows)).tobytes()
    lines: dict[int, list[int]] = {}
    for place, colour in enumerate(pixels):
        row, column = divmod(place, width)
        lines.setdefault(colour, [0] * width)[column] |= 1 << row
    return "$".join(f"#{colour}{_packed(bits)}" for colour, bits in lines.items()) + "-"


def _packed(bits: list[int]) -> str:
    """Return the columns of a band with repeats shortened: `!5~` for five full columns."""
    text = "".join(chr(63 + part) for part in bits)
    return re.sub(r"(.)\1{3,}", lambda run: f"!{len(run[0])}{run[1]}", text)
