"""Amplifier and LVDT of one valve on a serial card, as the two topics that the controller needs.

    python valve_driver.py --ros-args -p port:=/dev/ttyUSB0

The card samples its LVDT by a clock of its own, once per sample period, and sends a frame for each sample.
It takes a frame for each voltage. Both have five bytes: head, counter, a signed number of 16 bit (low byte
first), and the sum of the four bytes before it. An analogue card differs in ``Card`` alone.
"""

import math
import signal
import struct
import sys
import threading
import time
from collections.abc import Iterator

import rclpy
import serial
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64

FROM_CARD, TO_CARD = 0xA5, 0x5A  # heads of the frames
FRAME = struct.Struct("<BBhB")
FULL_SCALE = 32767  # counts
MOST_MISSED = 100  # samples; a larger gap is silence, which the controller finds by itself


class Card:
    """Frames on a serial port. Raises serial.SerialException if the port cannot be used."""

    def __init__(self, port: str, baud: int) -> None:
        self._port = serial.Serial(port, baud, timeout=0.1, write_timeout=0.05, exclusive=True)
        self._port.reset_input_buffer()  # what was sampled before nobody listened is stale
        self._counter = 0
        self._lock = threading.Lock()

    def readings(self) -> Iterator[tuple[int, int]]:
        """Counter and counts of each sound frame; a damaged one is left out. Ends when the port is closed."""
        data = b""
        while self._port.is_open:
            data += self._port.read(FRAME.size - len(data))
            if len(data) < FRAME.size:
                continue
            head, counter, counts, total = FRAME.unpack(data)
            if head == FROM_CARD and total == sum(data[:-1]) % 256:
                yield counter, counts
                data = b""
            else:
                data = data[1:]  # not the beginning of a frame

    def write(self, counts: int) -> None:
        """Send a voltage."""
        with self._lock:
            self._counter = (self._counter + 1) % 256
            data = FRAME.pack(TO_CARD, self._counter, counts, 0)[:-1]
            self._port.write(data + bytes([sum(data) % 256]))

    def close(self) -> None:
        """End ``readings``."""
        self._port.close()


class ValveDriver(Node):
    """Publishes `spool_position`, takes `valve_voltage`; gives 0 V when none came for `voltage_timeout`."""

    def __init__(self, stopped: threading.Event) -> None:
        """``stopped`` is set when the card is gone."""
        super().__init__("valve_driver")
        self._stopped = stopped
        port = str(self.declare_parameter("port", "/dev/ttyUSB0").value)
        baud = int(self.declare_parameter("baud", 460800).value)
        self._volts = float(self.declare_parameter("lvdt.volts_per_count", 10.0 / FULL_SCALE).value)
        self._zero = float(self.declare_parameter("lvdt.zero", 0.0).value)  # V in the middle position
        self._limit = float(self.declare_parameter("amplifier.limit", 10.0).value)  # V
        self._counts = float(self.declare_parameter("amplifier.counts_per_volt", FULL_SCALE / 10.0).value)
        self._timeout = float(self.declare_parameter("voltage_timeout", 0.1).value)  # s
        if self._volts == 0.0 or not 0.0 < self._limit * abs(self._counts) <= FULL_SCALE:
            raise ValueError(f"the scales are wrong: {self._limit:g} V must be within {FULL_SCALE} counts")
        self._card = Card(port, baud)
        self._positions = self.create_publisher(Float64, "spool_position", 10)
        self.create_subscription(Float64, "valve_voltage", self._on_voltage, 10)
        self._voltage_at = -math.inf  # s, when the last voltage came
        self.create_timer(self._timeout / 5.0, self._watch)
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        """Publish each reading at once: DDS gives it its time stamp and its number when it is published."""
        expected = None
        try:
            for counter, counts in self._card.readings():
                missed = 0 if expected is None else (counter - expected) % 256
                expected = (counter + 1) % 256
                if missed <= MOST_MISSED:
                    for _ in range(missed):  # the controller steps over these with their right time
                        self._positions.publish(Float64(data=math.nan))
                self._positions.publish(Float64(data=counts * self._volts - self._zero))
        except (serial.SerialException, OSError, TypeError) as error:  # TypeError: closed while it was read
            if not self._stopped.is_set():
                self.get_logger().error(f"the card is gone: {error}")
                self._stopped.set()

    def _on_voltage(self, message: Float64) -> None:
        voltage = message.data if math.isfinite(message.data) else 0.0
        self._voltage_at = time.monotonic()
        self._write(max(-self._limit, min(self._limit, voltage)))

    def _watch(self) -> None:
        if time.monotonic() - self._voltage_at > self._timeout:
            self._write(0.0)

    def _write(self, voltage: float) -> None:
        try:
            self._card.write(round(voltage * self._counts))
        except serial.SerialException as error:
            self.get_logger().error(f"voltage not sent: {error}", throttle_duration_sec=1.0)

    def close(self) -> None:
        """0 V, and the port closed."""
        self._write(0.0)
        self._card.close()
        self._listener.join(timeout=1.0)


def main() -> int:
    """Run the driver until SIGINT or SIGTERM; 2 if it cannot start."""
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        driver = ValveDriver(stopped)
        while not stopped.is_set():
            rclpy.spin_once(driver, timeout_sec=0.1)
        driver.close()
    except (ValueError, serial.SerialException) as error:
        print(f"valve_driver: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
