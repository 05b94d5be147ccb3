"""The servo's torque: turned on, turned off, lost; and the setpoints sent while it is on."""

from dataclasses import dataclass

from tailbeat.robot.servo import Servo, ServoFault

CHECK_EVERY = 2  # periods between two checks of torque or watchdog, in turn


@dataclass(eq=False)
class Torque:
    """`on`: it was turned on. `owing`: it must be off, but the servo has not confirmed it. `lost`:
    the servo turned it off itself. `watchdog`: the servo's own watchdog stopped it. `hardware`
    names the servo's errors. `sent` [rad] is the last setpoint."""

    on: bool = False
    owing: bool = False
    lost: bool = False
    watchdog: bool = False
    hardware: str = ""
    sent: float = 0.0
    turn: int = 0

    def switch_on(self, servo: Servo) -> None:
        """Turn torque on and hold the present angle. Raises ServoFault."""
        self.sent = servo.arm()
        self.on, self.watchdog, self.lost = True, False, False

    def switch_off(self, servo: Servo, tries: int) -> ServoFault | None:
        """Turn torque off; `owing` until the servo confirms it. Returns the last fault, if any."""
        self.on, self.owing, last = False, True, None
        for _ in range(tries):
            try:
                servo.torque_off()
                self.owing = False
                return last
            except ServoFault as fault:
                last = fault
        return last

    def check(self, servo: Servo, alert: bool) -> None:
        """Check the servo's torque and watchdog: one request every second period, so that the bus
        stays free. A missing reply shows in a reading's age."""
        self.turn += 1
        due = self.turn % CHECK_EVERY == 0
        try:
            if alert and not self.hardware:
                self.hardware = ", ".join(servo.hardware_errors())
            elif due and self.turn // CHECK_EVERY % 2:
                self.lost = not servo.is_on()
            elif due:
                self.watchdog = self.watchdog or servo.stopped_itself()
        except ServoFault:
            pass

    def send(self, servo: Servo, angle: float) -> None:
        """Send a setpoint [rad]."""
        try:
            self.sent = servo.write(angle)
        except ServoFault as fault:
            self._failed(fault)

    def release(self, servo: Servo) -> None:
        """Accept setpoints again from the present angle, after the servo's own watchdog stopped
        it."""
        try:
            self.sent = servo.release()
            self.watchdog = False
        except ServoFault as fault:
            self._failed(fault)

    def _failed(self, fault: ServoFault) -> None:
        self.watchdog = self.watchdog or fault.kind == "watchdog"
