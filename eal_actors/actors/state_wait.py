"""A future of a robot's state."""

from __future__ import annotations

from eal_actors.actors.future import Future, Timekeeper
from eal_actors.actors.robot_view import RobotState, RobotView
from eal_actors.kernel.errors import DeadlineError, EALError, UnavailableError


class StateWait(Future[RobotState]):
    """Done when a robot is in a state; it fails when the deadline passes, or when the robot can never get there.

    Args:
        view: the robot.
        state: the state.
        timeout_s: seconds of the fleet's clock.
        timekeeper: who rings the deadline.
    """

    def __init__(self, view: RobotView, state: RobotState, timeout_s: float, timekeeper: Timekeeper) -> None:
        super().__init__(view.clock, view.clock.now() + timeout_s, timekeeper)
        self._view = view
        self._wanted = state
        self._timeout_s = timeout_s
        forget = view.observe(self._look)
        self.link(lambda _, __: forget())
        self.arm()  # else a future that nobody waits for would be told of states for ever

    def describe(self) -> str:
        """See Future."""
        return f"{self._view.name}: wait for state {self._wanted.value}"

    def _look(self, state: RobotState) -> None:
        if state is self._wanted:
            self.set(state)
        elif state is RobotState.STOPPED or (state is RobotState.FAILED and self._wanted is not RobotState.STOPPED):
            why = f"it is {state.value}, and cannot become {self._wanted.value} any more"
            self.set_exception(UnavailableError(why, robot=self._view.name))

    def _expired(self) -> EALError:
        state = self._view.state.value
        message = f"still {state}, not {self._wanted.value}, after {self._timeout_s:g} s"
        return DeadlineError(message, robot=self._view.name)
