"""Makes the robot's status for the station from the loop's rows."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tailbeat.link.clock import SECOND
from tailbeat.link.datagrams import Receiver
from tailbeat.link.reasons import Reason
from tailbeat.link.status import Numbers, State, Status, status_datagram
from tailbeat.robot.safety import SafetyLimits

EVERY = 0.095  # s: ten a second; a little less than five periods, so that rounding skips none


@dataclass(eq=False)
class Reporter:
    """Makes a status from the loop's rows, ten a second."""

    due: float = -math.inf
    sequence: int = 0
    late: float = 0.0
    busy: float = 0.0

    def report(
        self,
        row: Mapping[str, Any],
        late: float,
        receiver: Receiver,
        limits: SafetyLimits,
        target: tuple[float, float] | None,
    ) -> bytes | None:
        """A status datagram if one is due, else None; `late` [s] is how late the row's period
        began."""
        self.late, self.busy = max(self.late, late), max(self.busy, row["busy_s"])
        if row["time_s"] < self.due or not receiver.run:
            return None  # no sender was heard yet
        status = _status(row, receiver, self._numbers(row, receiver, limits, target))
        self.due, self.late, self.busy = row["time_s"] + EVERY, 0.0, 0.0
        self.sequence += 1
        return status_datagram(receiver.key, receiver.run, receiver.nonce, self.sequence, status)

    def _numbers(
        self,
        row: Mapping[str, Any],
        receiver: Receiver,
        limits: SafetyLimits,
        target: tuple[float, float] | None,
    ) -> Numbers:
        target_x, target_y = target or (math.nan, math.nan)
        return Numbers(
            pose_age=row["pose_age_s"],
            pose_hold=limits.pose_hold,
            pose_stop=limits.pose_stop,
            angle=row["motor_angle_rad"],
            setpoint=row["command_rad"],
            temperature=row["temperature_deg_c"],
            voltage=row["voltage_v"],
            current=row["current_a"],
            late=self.late,
            busy=self.busy,
            band_share=row["band_share"],
            clock_doubt=row["clock_doubt_s"],
            loss=receiver.loss.share(),
            target_x=target_x,
            target_y=target_y,
        )


def _status(row: Mapping[str, Any], receiver: Receiver, numbers: Numbers) -> Status:
    offset = receiver.clock.offset(round(row["time_s"] * SECOND))
    return Status(
        state=State(row["state"]),
        reason=Reason[row["cause"].upper()],
        text=row["reason"],
        missed=row["missed"],
        rejects=receiver.rejected.total(),
        order=receiver.ordered.get(receiver.run, 0),
        offset=math.nan if offset is None else offset[0] / SECOND,
        numbers=numbers,
    )
