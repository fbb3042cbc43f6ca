"""Is an LVDT reading believable? Finite, in range, no faster than the spool, not frozen."""

import math
from typing import NamedTuple

SOUND = ""
TEXTS = {
    "not_finite": "LVDT readings are not finite",
    "out_of_range": "LVDT readings are out of range",
    "jump": "LVDT readings jump faster than the spool can move",
    "frozen": "LVDT readings stand still while the voltage moves: frozen LVDT or stuck spool",
    "silent": "LVDT is silent",
}


class Params(NamedTuple):
    """What is believed."""

    limit: float  # V
    max_rate: float  # V/s
    tolerance: float  # V
    frozen_samples: int  # 0: not watched
    frozen_voltage: float  # V
    period: float  # s


class Monitor:
    """Judges one reading after the other."""

    def __init__(self, params: Params) -> None:
        self.params = params
        self.forget()

    def forget(self) -> None:
        """Begin anew: the next reading has nothing before it."""
        self._last: float | None = None
        self._age = 0.0  # s since the last reading that counts
        self._raw: float | None = None  # the last finite reading, believed or not
        self._jumped = False
        self._equal = 0
        self._lowest = self._highest = 0.0
        self._frozen_at: float | None = None

    def judge(self, reading: float, missed: int, voltage: float, blocked: bool, elapsed: float) -> str:
        """``SOUND`` or the name of what is wrong with ``reading`` [V].

        ``missed``: samples lost before it; ``voltage`` [V]: applied until now; ``blocked``: whether the
        voltage is off already, so that a reading is compared with the one just before it, not with the
        last believable one; ``elapsed`` [s]: real time since the reading before, 0.0 if unknown.
        """
        p = self.params
        since = max((1 + missed) * p.period, elapsed)
        self._age += since
        if not math.isfinite(reading):
            return "not_finite"
        if abs(reading) > p.limit:
            return "out_of_range"
        last, raw, self._raw = self._last, self._raw, reading
        jumped = last is not None and abs(reading - last) > p.max_rate * self._age + p.tolerance
        # Readings that go on smoothly from one that jumped have jumped too, however long ago that is.
        smooth = raw is not None and abs(reading - raw) <= p.max_rate * since + p.tolerance
        if not blocked and (jumped or (self._jumped and smooth)):
            self._jumped = True
            return "jump"
        self._jumped = False
        self._last = reading
        self._age = 0.0
        if self._frozen_at is not None:
            if reading == self._frozen_at:
                return "frozen"
            self._frozen_at = None
        if reading != last:
            self._equal = 0
            self._lowest = self._highest = voltage
            return "jump" if jumped else SOUND
        self._equal += 1 + missed
        self._lowest = min(self._lowest, voltage)
        self._highest = max(self._highest, voltage)
        if 0 < p.frozen_samples <= self._equal and self._highest - self._lowest > p.frozen_voltage:
            if not blocked:
                self._frozen_at = reading
                return "frozen"
            self._equal = 0
            self._lowest = self._highest = voltage
        return SOUND
