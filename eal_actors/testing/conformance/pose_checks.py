"""The check of a pose estimate: where the robot says it is, and how sure it says that is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.device.localization.pose_estimate import MAP_FRAME, PoseEstimate, diagonal
from eal_actors.kernel.errors import ArgumentError
from eal_actors.testing.conformance.bench import Bench, Findings, wait_until

_POSE: Final = "Pose"
_BASE: Final = "Base"
_PLACE: Final = (1.0, -2.0, 0.5)
_DRIVE_M: Final = 0.05
_SHORT_M: Final = 0.5 * _DRIVE_M
_READ_S: Final = 5.0


def estimates_its_pose(bench: Bench, findings: Findings) -> None:
    """`Pose` follows the base, its uncertainty grows with the distance, and `set_value` and `fix` correct it."""
    with bench.robot() as robot:
        pose, base = robot.get(_POSE), robot.get(_BASE)
        if pose is None or "estimate" not in {request.name for request in pose.info.requests}:
            return
        findings.answer(pose.set_value(list(_PLACE)))
        before = _estimate(pose, findings)
        if before is None:
            return
        findings.expect(before.frame_id == MAP_FRAME, f"{_POSE}: its frame is not {MAP_FRAME!r}")
        findings.expect(_distance_m(before, _PLACE) < _SHORT_M, f"{_POSE}: set_value does not set the estimate")
        _check_fixes(pose, before, findings)
        corrected = _estimate(pose, findings)  # the fix has made it more certain
        if (
            corrected is not None
            and base is not None
            and "f<metres>" in {command.name for command in base.info.commands}
        ):
            findings.answer(base.send_cmd(f"f{_DRIVE_M}"))
            _check_drive(pose, corrected, findings)


def _check_drive(pose: ResourceHandle, before: PoseEstimate, findings: Findings) -> None:
    after: list[PoseEstimate] = []

    def has_moved() -> bool:
        if (found := _estimate(pose, findings)) is not None:
            after.append(found)
        return bool(after) and _distance_m(after[-1], (before.x_m, before.y_m)) > _SHORT_M

    moved = wait_until(has_moved, _READ_S)  # the last reading may be on its way
    if findings.expect(moved, f"{_POSE}: it does not follow the base") and after:
        course_rad = math.atan2(after[-1].y_m - before.y_m, after[-1].x_m - before.x_m)
        ahead = abs(math.remainder(course_rad - before.yaw_rad, math.tau)) < 0.5
        findings.expect(ahead, f"{_POSE}: a drive ahead does not move it along its yaw")
        grown = after[-1].covariance[2][2] > before.covariance[2][2]
        findings.expect(grown, f"{_POSE}: its uncertainty does not grow with the distance")


def _check_fixes(pose: ResourceHandle, estimate: PoseEstimate, findings: Findings) -> None:
    fix = PoseEstimate(estimate.x_m, estimate.y_m, estimate.yaw_rad, diagonal(0.01, 0.02), estimate.stamp_s)
    sent = EALData.of(fix.numbers(), frame_id=MAP_FRAME, stamp_s=fix.stamp_s)
    findings.expect(findings.answer(pose.send_cmd("fix", sent)) == 1, f"{_POSE}: a fix of its own pose is refused")
    singular = EALData.of([*fix.numbers()[:3], *[0.0] * 9], stamp_s=fix.stamp_s)
    for wrong in (singular, EALData.of(fix.numbers()), EALData.of([math.nan, *fix.numbers()[1:]], stamp_s=fix.stamp_s)):
        findings.refusal(pose.send_cmd("fix", wrong), ArgumentError)


def _estimate(pose: ResourceHandle, findings: Findings) -> PoseEstimate | None:
    """Return the estimate; record what is wrong with it."""
    data = findings.answer(pose.send_req("estimate"))
    if data is None:
        return None
    try:
        return PoseEstimate.of_numbers(list(data.value), data.stamp_s if data.stamp_s is not None else math.nan)
    except ArgumentError as error:
        findings.expect(False, f"{_POSE}: estimate: {error.message}")
        return None


def _distance_m(estimate: PoseEstimate, place: Sequence[float]) -> float:
    return math.hypot(estimate.x_m - place[0], estimate.y_m - place[1])
