"""A link between two parts of a ring that nothing clear connects.

Where something covers the seams, two overlaps of a closed ring may remain without a clear shift. The ring then falls
into two parts, and odometry alone places one against the other. The clearer of the two doubtful shifts is better than
that: it needs less correlation than a shift between strangers, because odometry says about where it is. The other
overlap follows from the closed ring.
"""

from __future__ import annotations

from collections.abc import Callable

from eal_actors.lab.panorama.cylinder import Shift
from eal_actors.lab.panorama.gradients import DoubtfulShift
from eal_actors.lab.panorama.ring import Links, Ring


def link_across_gap(
    ring: Ring, links: Links, doubtful: Callable[[int, int], DoubtfulShift | None]
) -> dict[tuple[int, int], Shift]:
    """Return the link that connects the two parts of a ring; none if there are not two parts, or no shift stands out.

    A single frame between two gaps is none: nothing says that it belongs there. `doubtful` returns the shift that
    stands out most between two neighbours, if one does; `links` are the clear shifts.
    """
    neighbours = [(one, other) for one, other, _ in ring.neighbours()]
    gaps = [pair for pair in neighbours if pair not in links]
    linked = {number for pair in links for number in pair}
    if not ring.is_closed or len(gaps) != 2 or not linked.issuperset(ring.order):
        return {}
    found = {pair: shift for pair in gaps if (shift := doubtful(*pair)) is not None}
    if not found:
        return {}
    best = max(found, key=lambda pair: found[pair].prominence)
    return {best: found[best].shift}
