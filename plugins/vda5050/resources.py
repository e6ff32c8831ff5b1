"""The state of an AGV as resources, and its actions."""

from __future__ import annotations

import json
import uuid
from typing import Any, Final

from pydantic import ValidationError
from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    DataType,
    EALData,
    NotReadyError,
    Resource,
    ResourceFaultError,
    ResourceType,
    UnavailableError,
    ValueInfo,
    json_object,
    request,
)

from .link import AgvLink
from .messages import AgvAction

_POLL_S: Final = 0.05
_FACTSHEET_S: Final = 3.0
_JSON: Final = ValueInfo(DataType.CHAR, description="JSON")


class AgvResource(Resource):
    """A resource of an AGV."""

    def __init__(self, link: AgvLink) -> None:
        self._link = link

    @override
    def not_ready(self) -> str | None:
        return self._link.why_not_ready()


class Battery(AgvResource):
    """The battery's charge, 0 to 1."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, None, 0, 1, description="fraction of the capacity that is left")

    def get_value(self) -> EALData:
        """Return the charge as a share of the capacity."""
        charge = self._link.state().battery_state.battery_charge / 100.0
        return EALData.of(min(1.0, max(0.0, charge)), stamp_s=self._link.arrived_s)

    @request("voltage", ValueInfo(DataType.DOUBLE, "V"))
    def voltage(self) -> EALData:
        """Return the terminal voltage."""
        voltage_v = self._link.state().battery_state.battery_voltage
        if voltage_v is None:
            raise UnavailableError("the AGV does not report its battery's voltage")
        return EALData.of(voltage_v, unit="V", stamp_s=self._link.arrived_s)

    @request("charging", ValueInfo(DataType.BOOL))
    def charging(self) -> bool:
        """Return whether it is being charged."""
        return self._link.state().battery_state.charging


class StateReport(AgvResource):
    """The AGV's newest state, as a JSON object of the standard's fields."""

    types = ResourceType.SENSOR
    value = _JSON

    def get_value(self) -> EALData:
        """Return the newest state."""
        return EALData.of(json.dumps(self._link.state().wire()), stamp_s=self._link.arrived_s)

    @override
    def send_req(self, req: str) -> str:
        """Return one field of the state as JSON, such as `errors`, `actionStates` or `safetyState`.

        Raises:
            ArgumentError: the state has no such field.
        """
        fields = self._link.state().wire()
        if req not in fields:
            raise ArgumentError(f"the state has no field {req!r}; it has {', '.join(sorted(fields))}")
        return json.dumps(fields[req])


class Factsheet(AgvResource):
    """The AGV's own description, as a JSON object; it is asked for when it is not known."""

    types = ResourceType.SENSOR
    value = _JSON

    def __init__(self, link: AgvLink) -> None:
        super().__init__(link)
        self._newest: Any = None

    def get_value(self) -> Activity:
        """Return the newest factsheet; the AGV is asked for it if there is none.

        Raises:
            DataError: it is too long.
            NotReadyError: the AGV sends none.
        """
        self._take()
        if self._newest is None:
            self._link.send_actions([_action({"actionType": "factsheetRequest"})])
        for _ in range(round(_FACTSHEET_S / _POLL_S)):
            if self._newest is not None:
                return json.dumps(self._newest)
            yield _POLL_S
            self._take()
        raise NotReadyError(f"the AGV has sent no factsheet within {_FACTSHEET_S:g} s")

    def _take(self) -> None:
        while (received := self._link.factsheets.take()) is not None:
            try:
                self._newest = json.loads(received.payload)
            except (ValueError, RecursionError) as error:
                raise ResourceFaultError(f"the AGV's factsheet is no JSON: {error}") from None


class Actions(AgvResource):
    """Instant actions: a request is one as a JSON object, or its type; the answer is its result."""

    types = ResourceType.ACTUATOR

    @override
    def send_req(self, req: str) -> Activity:
        """Carry out an instant action, such as `stateRequest` or `{"actionType": "initPosition", ...}`.

        Raises:
            ArgumentError: the text is no action.
            ResourceFaultError: the action failed.
            UnavailableError: the AGV is out of reach.
        """
        action = _action(_fields(req))
        self._link.send_actions([action])
        while True:
            state = self._link.state()
            if (now := state.action(action.action_id)) is not None:
                if now.action_status == "FINISHED":
                    return now.result_description or "FINISHED"
                if now.action_status == "FAILED":
                    reasons = "; ".join(error.text() for error in state.errors if error.is_about(action.action_id))
                    raise ResourceFaultError(
                        f"{action.action_type} failed: {reasons or now.result_description or 'no reason'}"
                    )
            yield _POLL_S

    @override
    def halt(self) -> None:
        """Do nothing: the halt of Base cancels and pauses."""


def _fields(text: str) -> dict[str, Any]:
    if text.isalnum():
        return {"actionType": text}
    return json_object(text, "an action is its type or a JSON object")


def _action(fields: dict[str, Any]) -> AgvAction:
    try:
        return AgvAction.model_validate({"actionId": uuid.uuid4().hex, "blockingType": "NONE", **fields})
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        raise ArgumentError(f"the action's {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
