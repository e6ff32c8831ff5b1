"""`eal ports`: list the serial ports of this machine."""

from __future__ import annotations

from typing import Any

from rich.text import Text

from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import new_table, print_line, stderr, stdout, write_json
from eal_actors.device.serial_ports import SerialPortEntry, list_serial_ports


def show_ports(as_json: JsonOption = False) -> None:
    """List the serial ports of this machine: lasting names, USB ids, and the programs that hold them.

    No port is opened. Write the lasting name into the fleet file: the number of /dev/ttyUSB0 depends on the order of
    plugging in. Programs of other users are visible to root only.
    """
    ports = list_serial_ports()
    if as_json:
        write_json({"ports": [_as_json(port) for port in ports]})
        return
    if not ports:
        print_line(stderr(), "This machine has no serial port.")
        return
    table = new_table("port", "lasting name", "USB id", "held by")
    for port in ports:
        name = "\n".join(map(str, port.names)) or "none"
        table.add_row(_describe(port), name, port.usb or "none", "\n".join(map(str, port.holders)) or "nobody")
    stdout().print(table)


def _describe(port: SerialPortEntry) -> Text:
    """Return a port's path and what is unusual about it."""
    text = Text(str(port.path), style="cyan")
    if port.product:
        text.append(f"\n{port.product}", style="dim")
    if port.latency_ms is not None:
        text.append(f"\nlatency {port.latency_ms} ms", style="dim")
    if not port.is_usable:
        text.append(f"\nmay be opened by {f'the group {port.group}' if port.group else 'root'} only", style="yellow")
    return text


def _as_json(port: SerialPortEntry) -> dict[str, Any]:
    return {
        "path": str(port.path),
        "names": [str(name) for name in port.names],
        "usb": port.usb,
        "product": port.product,
        "latency_ms": port.latency_ms,
        "usable": port.is_usable,
        "group": port.group,
        "holders": [{"pid": holder.pid, "program": holder.program} for holder in port.holders],
    }
