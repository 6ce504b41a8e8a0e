"""The car's quantities by name, with the effects that change them: what the formats pick from.

C_alpha, C_kappa are AXLE values, both tyres together. Names are those of `Vehicle` and of the catalogue of effects.

A payload of mass m_p, x ahead of the empty car's centre of gravity, is put on it as the model does (`payload` in
physics/body_forces.py): m + m_p, l_f - s x and I_z + s m x^2, with s = m_p / (m + m_p); all of it is sprung.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from vehicle_sbi.inference.prior import KNOWN
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.report.export.exported import Exported, Value, made_of

UNITS: Mapping[str, str] = {
    **{name: p.unit for name, p in KNOWN.items() if not p.relative},
    "m": "kg",
    "I_z": "kg m^2",
    "steering_ratio": "1",
}

FACTORS: Mapping[str, tuple[str, ...]] = {
    **{f"C_{way}_f": ("stiffness_level.factor", "stiffness_level.front") for way in ("alpha", "kappa")},
    **{f"C_{way}_r": ("stiffness_level.factor", "stiffness_level.rear") for way in ("alpha", "kappa")},
    "mu": ("friction_level.factor",),
    "R_f": ("wheel_radius.front",),
    "I_z": ("yaw_inertia.factor",),
}
"""What effects multiply a constant by, where they are free."""

LOADED: Mapping[str, tuple[tuple[str, ...], Callable[..., float]]] = {
    "m": (("payload.mass",), lambda m, load: m + load),
    "m_s": (("payload.mass",), lambda m_s, load: m_s + load),
    "l_f": (("m", "payload.mass", "payload.x"), lambda l_f, m, load, x: l_f - load / (m + load) * x),
    "I_z": (("m", "payload.mass", "payload.x"), lambda I_z, m, load, x: I_z + load / (m + load) * m * x**2),
}
"""What a payload makes of a constant of the empty car, and what else of both this needs."""

WITH_PAYLOAD = "the payload of the drive is in it"

CENTRE: Mapping[str, tuple[tuple[str, ...], Callable[..., float]]] = {
    "x": (("L", "l_f"), lambda L, l_f: L - l_f),
    "y": ((), lambda: 0.0),
    "z": (("h_cog",), lambda h_cog: h_cog),
}
"""Where the centre of gravity is in Autoware's base_link [m], and the quantities that this needs."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A key of a file, its value (None: left out, `why` says for lack of what) and what is to be said beside it."""

    key: str
    value: Value | None
    why: str = ""
    note: str = ""
    stated: tuple[str, ...] = ()


@dataclass(frozen=True)
class Car:
    """A car as far as a run or diagnosis knows it."""

    known: Exported

    def quantity(self, name: str) -> Value | None:
        """A constant of the car as driven, or a parameter of an effect; None where it is not known."""
        value = self._empty(name)
        if value is None or not self.has_payload(name):
            return value
        needs, function = LOADED[name]
        found = [self._empty(one) if one in (*LOADED, *self.known.inferred) else _null(one) for one in needs]
        values = [one for one in found if one is not None]
        return made_of(function, value, *values, unit=value.unit) if len(values) == len(needs) else None

    def has_payload(self, *names: str) -> bool:
        """Whether a payload of the drive is in any of these quantities."""
        return "payload.mass" in self.known.inferred and any(name in LOADED for name in names)

    def _empty(self, name: str) -> Value | None:
        """A constant of the empty car with the factors on it, or a parameter of an effect."""
        value = self._named(name)
        for one in self._factors(name):
            factor = self.known.parameter(one)
            if value is None or factor is None:
                return None
            value = made_of(lambda a, b: a * b, value, factor, unit=value.unit)
        return value

    def entry(self, key: str, unit: str, function: Callable[..., float], *needs: str, note: str = "") -> Entry:
        """A key whose value [unit] is a function of the quantities that it `needs`."""
        found = {name: self.quantity(name) for name in needs}
        values = [value for value in found.values() if value is not None]
        if len(values) < len(needs):
            return Entry(key=key, value=None, why="; ".join(self.why_not(n) for n, v in found.items() if v is None))
        stated = tuple(name for name, value in found.items() if value is not None and not value.slopes)
        value = made_of(function, *values, unit=unit)
        return Entry(key=key, value=value, note=self._noted(note, needs), stated=stated)

    def same(self, key: str, name: str, note: str = "") -> Entry:
        """A key that takes a quantity as it is."""
        value = self.quantity(name)
        if value is None:
            return Entry(key=key, value=None, why=self.why_not(name))
        return Entry(key=key, value=value, note=self._noted(note, (name,)), stated=() if value.slopes else (name,))

    def place(self, axis: str) -> Entry:
        """Where the IMU is along an axis of base_link [m]: x ahead of the rear axle, y left, z above the ground."""
        arm, placed = f"imu_lever_arm.{axis}", f"imu_{axis}"
        needs, function = CENTRE[axis]
        if self._setting(placed) or placed in self.known.stated:
            needs, function = (placed,), lambda at: at
            if arm not in self.known.inferred:
                return self.same(axis, placed)
        return self.entry(axis, "m", lambda more, *at: function(*at) + more, arm, *needs)

    def why_not(self, name: str) -> str:
        """Why a quantity is not known."""
        parts = [*self._setting(name), *self._factors(name), *self._load(name)]
        parts += ["steering_ratio.gain"] if name == "steering_ratio" else []
        culprits = [one for one in parts if one in self.known.not_identified]
        if culprits:
            return "; ".join(f"{one}: {self.known.inferred[one].why_not}" for one in culprits)
        if self._setting(name):
            return f"{self._setting(name)[0]}: an offset from a nominal {name} that is not known"
        effect = name.split(".")[0]
        if "." in name and effect in self.known.doubted:
            return f"{name}: not found to be missing (probability {self.known.doubted[effect]:.2f})"
        return f"{name}: not inferred" if "." in name else f"{name}: neither inferred nor stated"

    def _factors(self, name: str) -> list[str]:
        """The free parameters that multiply a constant."""
        return [one for one in FACTORS.get(name, ()) if one in self.known.inferred]

    def _load(self, name: str) -> list[str]:
        """The free parameters of a payload that a constant depends on."""
        needs = LOADED[name][0] if self.has_payload(name) else ()
        return [one for one in needs if one in self.known.inferred]

    def _noted(self, note: str, names: Sequence[str]) -> str:
        """A note, with that of the payload where one is in any of these quantities."""
        return "; ".join(filter(None, (note, WITH_PAYLOAD if self.has_payload(*names) else "")))

    def _named(self, name: str) -> Value | None:
        """A quantity without the factors on it."""
        if name == "steering_ratio":
            return self._steering_ratio()
        if name == "I_z" and "I_z" not in self.known.stated:
            return self._yaw_inertia()
        for one in self._setting(name):
            value, parameter = self.known.parameter(one), KNOWN[one]
            return None if value is None else self._constant(name, value, parameter)
        return self._stated(name)

    def _constant(self, name: str, value: Value, parameter: Parameter) -> Value | None:
        """A constant that a parameter sets: itself, or so many times its scale off the nominal value."""
        if not parameter.relative:
            return value
        nominal = self.known.nominal.get(name)
        if nominal is None:
            return None
        slopes = {one: slope * parameter.scale for one, slope in value.slopes.items()}
        return Value(mean=nominal + parameter.scale * value.mean, unit=UNITS[name], slopes=slopes)

    def _setting(self, name: str) -> list[str]:
        """The free parameter that sets a quantity, if there is one."""
        field = name.replace(".", "_")
        return [one for one in self.known.inferred if one in KNOWN and field in KNOWN[one].fields]

    def _stated(self, name: str) -> Value | None:
        constant = self.known.stated.get(name)
        return None if constant is None else Value(mean=constant, unit=UNITS.get(name, ""), slopes={})

    def _steering_ratio(self) -> Value | None:
        """Steering wheel to road wheel: the stated ratio over the gain, where that is free."""
        stated, gain = self._stated("steering_ratio"), self.known.parameter("steering_ratio.gain")
        if "steering_ratio.gain" not in self.known.inferred or stated is None:
            return stated
        return None if gain is None else made_of(lambda ratio, g: ratio / g, stated, gain, unit="1")

    def _yaw_inertia(self) -> Value | None:
        """m l_f l_r [kg m^2] of the empty car, the model's yaw inertia where none is stated."""
        parts = [self._empty(name) for name in ("m", "L", "l_f")]
        values = [value for value in parts if value is not None]
        if len(values) < len(parts):
            return None
        return made_of(lambda m, L, l_f: m * l_f * (L - l_f), *values, unit="kg m^2")


def _null(name: str) -> Value:
    """A parameter of an effect that is not free, where the effect vanishes."""
    return Value(mean=KNOWN[name].null or 0.0, unit=KNOWN[name].unit, slopes={})
