"""Driving a robot by the keys of the page, in a real Chromium."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from eal_actors.facade.fleet import Fleet
from eal_actors.operate.dashboard import Dashboard
from tests.operate.dashboard.rig import page_of, resource_of, wait_for

OpenPage = Callable[..., AbstractContextManager[Page]]

pytestmark = pytest.mark.timeout(180)
expect.set_options(timeout=20_000)


@pytest.fixture
def driving(open_page: OpenPage, dashboard: Dashboard) -> Iterator[Page]:
    """A page on which the W key drives robot one."""
    with open_page(dashboard.link + "#/robot/one") as page:
        page.get_by_role("button", name="Drive with keys").click()
        yield page


def hold(page: Page, fleet: Fleet) -> Any:
    """Hold W until the robot has received several twists; again, if a busy machine delays the page for too long."""
    base = resource_of(fleet, "one", "Base")
    for _ in range(10):
        with base.changed:
            twists, halts = base.twists, base.halts
        page.keyboard.down("w")
        wait_for(base, lambda: base.twists >= twists + 3 or base.halts > halts)  # noqa: B023  # waits in this round
        with base.changed:
            if base.halts == halts:
                assert base.twist[0] > 0
                return base
        page.keyboard.up("w")
    raise AssertionError("the page never sent drive messages in time")


def halted(base: Any) -> None:
    wait_for(base, lambda: base.twist == [0.0, 0.0])


def test_releasing_the_key_halts(driving: Page, fleet: Fleet) -> None:
    base = hold(driving, fleet)
    driving.keyboard.up("w")
    halted(base)


def test_a_hanging_page_halts_its_robot_and_ends_the_press(driving: Page, fleet: Fleet) -> None:
    base = hold(driving, fleet)
    driving.evaluate("const end = Date.now() + 1500; while (Date.now() < end);")
    halted(base)
    expect(driving.locator("main")).to_contain_text("Halted: no drive message for 0.3 s")
    assert base.twist == [0.0, 0.0]  # though the key is still down
    driving.keyboard.up("w")
    hold(driving, fleet)


def test_a_tab_that_loses_the_focus_releases_the_keys(driving: Page, fleet: Fleet) -> None:
    base = hold(driving, fleet)
    driving.evaluate("window.dispatchEvent(new Event('blur'))")
    halted(base)


def test_a_key_that_another_key_renames_is_released(driving: Page, fleet: Fleet) -> None:
    base = hold(driving, fleet)
    keyboard = driving.context.new_cdp_session(driving)
    keyboard.send("Input.dispatchKeyEvent", {"type": "keyUp", "key": "\u0142", "code": "KeyW"})  # W released with AltGr
    halted(base)


@pytest.mark.parametrize("how", ["Meta", "ContextMenu"])
def test_what_may_swallow_the_release_of_a_key_releases_it(driving: Page, fleet: Fleet, how: str) -> None:
    base = hold(driving, fleet)
    if how == "Meta":  # macOS reports no release of other keys while it is held
        driving.keyboard.down("Meta")
    else:  # a menu takes the keys
        driving.get_by_role("heading", name="one").click(button="right")
    halted(base)


def test_a_button_of_the_pad_is_held_by_the_space_bar(open_page: OpenPage, dashboard: Dashboard, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    with open_page(dashboard.link + "#/robot/one") as page:
        for last in ("release", "focus"):
            page.get_by_role("button", name="hold to drive ahead").focus()
            with base.changed:
                twists = base.twists
            page.keyboard.down("Space")
            wait_for(base, lambda: base.twists > twists)  # noqa: B023  # waits in this round
            if last == "focus":
                page.keyboard.press("Tab")
            else:
                page.keyboard.up("Space")
            halted(base)
            page.keyboard.up("Space")


def test_a_slider_that_has_the_focus_leaves_the_letters_to_driving(driving: Page, fleet: Fleet) -> None:
    driving.get_by_role("slider", name="Speed in m/s").focus()
    hold(driving, fleet)


def test_a_halt_of_another_user_ends_the_press(driving: Page, fleet: Fleet, dashboard: Dashboard) -> None:
    base = hold(driving, fleet)
    with page_of(dashboard) as other:
        assert other.ask(do="command", robots=["one"], resource="", text="halt")["ok"]
    expect(driving.locator("main")).to_contain_text("Halted: by another command")
    halted(base)
    assert base.twist == [0.0, 0.0]  # though the key is still down
    driving.keyboard.up("w")
    hold(driving, fleet)


def test_another_view_releases_the_keys(driving: Page, fleet: Fleet) -> None:
    base = hold(driving, fleet)
    driving.evaluate("location.hash = '#/map'")
    halted(base)


def test_a_closed_page_releases_the_keys(driving: Page, fleet: Fleet) -> None:
    base = hold(driving, fleet)
    driving.close()
    halted(base)


def test_keys_do_nothing_before_they_are_armed(open_page: OpenPage, dashboard: Dashboard, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    with open_page(dashboard.link + "#/robot/one") as page:
        expect(page.get_by_role("button", name="Drive with keys")).to_be_visible()
        page.keyboard.press("w")
        page.keyboard.press("Escape")  # after which the server has heard everything before it
        expect(page.locator("#stopped")).to_be_visible()
        assert base.twists == 0


PAD = """
window.pad = { connected: true, mapping: 'standard', axes: [0, -1, 0, 0],
               buttons: Array.from({ length: 17 }, () => ({ pressed: false })) };
window.onPadRead = () => {};
navigator.getGamepads = () => { window.onPadRead(); return [window.pad]; };
"""
"""A gamepad in the form of the Gamepad API: Chromium has no way to plug one in."""
THREE_PAD_READS = """
new Promise((done) => { let reads = 0; window.onPadRead = () => { if (++reads === 3) done(null); }; })
"""


def press_pad(page: Page, base: Any) -> None:
    """Hold the dead-man button until the robot drives; again, if a busy machine delays the page for too long."""
    for _ in range(10):
        with base.changed:
            twists, halts = base.twists, base.halts
        page.evaluate("window.pad.connected = true; window.pad.buttons[5].pressed = true")
        wait_for(base, lambda: base.twists >= twists + 2 or base.halts > halts)  # noqa: B023  # waits in this round
        with base.changed:
            if base.halts == halts:
                assert base.twist[0] > 0
                return
        page.evaluate("window.pad.buttons[5].pressed = false")
    raise AssertionError("the page never sent drive messages in time")


def test_a_gamepad_drives_while_its_dead_man_button_is_held(driving: Page, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    driving.evaluate(PAD)
    for end in ("window.pad.buttons[5].pressed = false", "window.pad.connected = false"):
        press_pad(driving, base)
        driving.evaluate(end)
        halted(base)
    with base.changed:
        twists = base.twists
    for state in ("connected = true", "buttons[5].pressed = false"):  # still held when it comes back; the stick alone
        driving.evaluate(f"window.pad.{state}")
        driving.evaluate(THREE_PAD_READS)
    driving.keyboard.press("Escape")  # after which the server has heard everything before it
    expect(driving.locator("#stopped")).to_be_visible()
    assert base.twists == twists


def test_a_window_without_the_focus_is_driven_by_no_gamepad(driving: Page, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    driving.evaluate(PAD)
    press_pad(driving, base)
    driving.evaluate("window.dispatchEvent(new Event('blur'))")
    halted(base)
    with base.changed:
        twists = base.twists
    driving.evaluate(THREE_PAD_READS)  # the button is still held
    driving.evaluate("document.hasFocus = () => false; window.pad.buttons[5].pressed = false")
    driving.evaluate(THREE_PAD_READS)
    driving.evaluate("window.pad.buttons[5].pressed = true")  # for another window
    driving.evaluate(THREE_PAD_READS)
    driving.evaluate("document.hasFocus = () => true")  # and held when the focus comes back
    driving.evaluate(THREE_PAD_READS)
    driving.keyboard.press("Escape")  # after which the server has heard everything before it
    expect(driving.locator("#stopped")).to_be_visible()
    assert base.twists == twists


def test_a_gamepad_that_is_held_while_it_is_armed_drives_when_it_is_pressed_again(driving: Page, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    driving.get_by_role("button", name="Drive with keys").click()
    driving.evaluate(PAD)
    driving.evaluate("window.pad.buttons[5].pressed = true")
    driving.get_by_role("button", name="Drive with keys").click()
    driving.evaluate(THREE_PAD_READS)
    assert base.twists == 0
    driving.evaluate("window.pad.buttons[5].pressed = false")
    driving.evaluate(THREE_PAD_READS)
    press_pad(driving, base)
