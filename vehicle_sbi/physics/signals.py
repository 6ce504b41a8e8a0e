"""Signals that come late, swing or come and go: delays, lags, springs with dampers, pulses."""

import math

from vehicle_sbi.compiled import compiled

EDGE = 0.1  # [s] over which what begins or ends at a moment does so
SPRUNG = 0.15  # damping ratio of a body on its springs at least
SHORTEST = 1e-9  # [s] of a natural period, below which there is none


@compiled
def interpolate(signal, position: float) -> float:
    """The signal at a fractional sample `position`, held beyond its ends.

    Between samples it is the cubic of Keys (1981), whose slope at each is that of the line through its neighbours. A
    straight line between samples would take off up to 1 - cos(w / 2) of what turns by w a sample, and have a kink at
    each, where fits of a dead time stop.
    """
    last = len(signal) - 1
    if position <= 0.0:
        return signal[0]
    if position >= last:
        return signal[last]
    k = int(position)
    share = position - k
    if share == 0.0:
        return signal[k]
    now, then = signal[k], signal[k + 1]
    change = then - now
    slope = 0.5 * (then - signal[k - 1]) if k > 0 else change
    slope_then = 0.5 * (signal[k + 2] - now) if k + 1 < last else change
    bend, twist = 3.0 * change - 2.0 * slope - slope_then, slope + slope_then - 2.0 * change
    return now + share * (slope + share * (bend + share * twist))


@compiled
def lagged(y: float, before: float, now: float, lag: float, rate: float) -> float:
    """A first-order lag [s] a sample after `y`, exactly, its input linear from `before` to `now`; `now` without a lag.

    lag dy/dt = u - y has y = u - lag du/dt as its particular solution on a straight line u.
    """
    if lag <= 0.0:
        return now
    trailing = rate * lag * (now - before)
    return now - trailing + math.exp(-1.0 / (rate * lag)) * (y - before + trailing)


@compiled
def swaying(
    y: float, dy: float, before: float, now: float, lag: float, period: float, rate: float
) -> tuple[float, float, float]:
    """Spring and damper a sample after (`y`, `dy`), exactly, input linear from `before` to `now`: y, dy/dt, d2y/dt2.

    With T the natural period [s] over 2 pi and c = lag + 2 SPRUNG T, T^2 d2y/dt2 + c dy/dt = u - y has
    y = u - c du/dt as its particular solution on a straight line u; the rest decays as it does without input. Without
    a period it is a first-order lag [s], and without that the line itself.
    """
    slope = rate * (now - before)
    if period <= SHORTEST and lag <= 0.0:
        return now, slope, 0.0
    if period <= SHORTEST:
        y = lagged(y, before, now, lag, rate)
        dy = (now - y) / lag
        return y, dy, (slope - dy) / lag
    T = period / (2.0 * math.pi)
    c, stiffness = max(lag, 0.0) + 2.0 * SPRUNG * T, 1.0 / (T * T)
    a = 0.5 * c * stiffness
    cosine, sine = _free(a, a * a - stiffness, stiffness, 1.0 / rate)
    off, d_off = y - before + c * slope, dy - slope
    y = now - c * slope + (cosine + a * sine) * off + sine * d_off
    dy = slope - stiffness * sine * off + (cosine - a * sine) * d_off
    return y, dy, stiffness * (now - y - c * dy)


@compiled
def _free(a: float, square: float, stiffness: float, t: float) -> tuple[float, float]:
    """exp(-a t) times cosh(w t) and sinh(w t) / w, w^2 being `square` = a^2 - stiffness, which may be negative."""
    w = math.sqrt(abs(square))
    if square < 0.0:
        return math.exp(-a * t) * math.cos(w * t), math.exp(-a * t) * math.sin(w * t) / w
    slow, fast = math.exp(-stiffness / (a + w) * t), math.exp(-(a + w) * t)
    return 0.5 * (slow + fast), 0.5 * (slow - fast) / w if w * t > 1e-6 else t * slow


@compiled
def rise(t: float) -> float:
    """0 before t = 0, 1 after EDGE, a smooth cubic between."""
    share = min(max(t / EDGE, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


@compiled
def pulse(t: float, start: float, duration: float) -> float:
    """1 from `start` on for `duration` [s], with smooth edges; 0 everywhere where it lasts no time."""
    return rise(t - start) - rise(t - start - duration) if duration > 0.0 else 0.0
