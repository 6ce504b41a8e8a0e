"""Priors: from the nested YAML of a prior file to a parameter space."""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS
from vehicle_sbi.physics.sensors import AXES, GROUPS, MEASUREMENTS
from vehicle_sbi.physics.size import size_of
from vehicle_sbi.physics.vehicle import BODY_PRIORS, GENERIC_PRIORS, IMU_PRIORS, Vehicle

DELTA_SCALE = 1e5
USUAL = "usual"  # of a box: that of a car of this size
PLACES = 0.35, 0.65  # of the wheelbase, between which centres of gravity lie behind the front axle


def _delta(name: str, unit: str, low: float, high: float, *fields: str) -> Parameter:
    """The paper's Delta C: an offset from nominal in units of 1e5 (its Table II gives the box)."""
    return Parameter(name=name, unit=unit, low=low, high=high, fields=fields, scale=DELTA_SCALE, relative=True)


DELTAS: Mapping[str, Parameter] = {
    p.name: p
    for p in (
        _delta("delta_C_kappa_f", "1e5 N", -0.2, 0.5, "C_kappa_f"),
        _delta("delta_C_kappa_r", "1e5 N", -0.2, 0.5, "C_kappa_r"),
        _delta("delta_C_kappa", "1e5 N", -0.2, 0.5, "C_kappa_f", "C_kappa_r"),
        _delta("delta_C_alpha_f", "1e5 N/rad", -0.3, 0.3, "C_alpha_f"),
        _delta("delta_C_alpha_r", "1e5 N/rad", -0.3, 0.3, "C_alpha_r"),
    )
}

UNUSED = {
    "torque": (),
    "wheel_speed": ("I_wf", "I_wr"),
    "speed": ("C_kappa_f", "C_kappa_r", "I_wf", "I_wr"),
}
"""Constants that no measurement depends on in a drive mode: what it is given takes their place."""

KNOWN: Mapping[str, Parameter] = {**GENERIC_PRIORS, **BODY_PRIORS, **IMU_PRIORS, **DELTAS, **EFFECT_PARAMETERS}


def flatten(prior: Mapping[str, Any]) -> dict[str, Any]:
    """`{aero_drag: {area: [0, 1]}}` as `{"aero_drag.area": [0, 1]}`, without what is null."""
    return {name: value for name, value in _joined(prior).items() if value is not None}


def stated(prior: Mapping[str, Any]) -> frozenset[str]:
    """Full names of all that a prior names, what it takes out by a null included."""
    return frozenset(_joined(prior))


def _joined(prior: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """A prior by full names, nulls included."""
    flat: dict[str, Any] = {}
    for name, value in prior.items():
        flat |= _joined(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {f"{prefix}{name}": value}
    return flat


def _boxed(name: str, value: Any) -> Parameter:
    """A parameter with the box that a prior states."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 2:
        raise InputError(f"prior: {name} = {value!r}; a prior is a pair [low, high], or {USUAL}")
    try:
        low, high = float(value[0]), float(value[1])
    except (TypeError, ValueError):
        raise InputError(f"prior: {name} = {value!r}; low and high must be numbers") from None
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(f"prior: {name} = [{low:g}, {high:g}]; low must be below high")
    return replace(KNOWN[name], low=low, high=high)


def unused(drive: str, model: str, sensed: Collection[str]) -> tuple[str, ...]:
    """Constants that none of the channels depends on, which are `sensed` or drive the model."""
    turning = model == "full_vehicle" or any(channel.startswith("wheel_speed") for channel in sensed)
    return (*UNUSED[drive], *(("R_f",) if drive == "speed" and not turning else ()))


def reported(p: Parameter, sensed: Mapping[str, str]) -> bool:
    """Whether a parameter of one sensor or axis, or of a group of them, belongs to what is recorded.

    `sensed` has the group of each channel; of a group with but one channel, the group's parameter stands for both.
    """
    leaf = p.name.split(".")[-1]
    if p.name in AXES:
        return AXES[p.name] in sensed
    if leaf in GROUPS:
        return leaf in sensed.values()
    if leaf in MEASUREMENTS:
        return leaf in sensed and [*sensed.values()].count(sensed[leaf]) > 1
    return True


def shared(p: Parameter, sensed: Mapping[str, str]) -> bool:
    """Whether a parameter belongs to what is recorded, and is not what one channel has beside its group of sensors."""
    return reported(p, sensed) and p.name.split(".")[-1] not in MEASUREMENTS


def typical(vehicle: Vehicle, model: str) -> dict[str, float]:
    """For each constant that the vehicle file leaves out the middle of its box for a car of this size."""
    boxes = {name: usual(name, vehicle) for name in vehicle.missing(model)}
    return {name: 0.5 * (box.low + box.high) for name, box in boxes.items()}


def usual(name: str, vehicle: Vehicle) -> Parameter:
    """A parameter with the box of a car of this size; where its centre of gravity is, of a car of this wheelbase."""
    if name == "l_f" and vehicle.L is not None:
        return replace(KNOWN[name], low=PLACES[0] * vehicle.L, high=PLACES[1] * vehicle.L)
    return size_of(vehicle.m, vehicle.L).fitted(KNOWN[name])


def parameter_space(
    prior: Mapping[str, Any],
    *,
    vehicle: Vehicle,
    model: str,
    effects: Sequence[str] = (),
    drive: str = "torque",
    sensed: Mapping[str, str] | None = None,
) -> ParameterSpace:
    """The free parameters: those of the prior file, those of the effects, and what the vehicle file leaves out.

    Of an effect all parameters are free; of a name like `sensor_lag.imu` that one alone.
    Boxes that are not stated, or stated as `usual`, are those of a car of this size. A null takes a parameter out of
    the prior, and one of an effect out of the effect: it stays where that vanishes. With what is `sensed` (the group of
    each channel), neither constants that nothing recorded depends on are freed nor what effects do to sensors that are
    not recorded; what one channel has beside its group of sensors is free only by its name.
    Raises InputError for an unknown name, a box with low >= high, or one in which no vehicle exists.
    """
    free: dict[str, Parameter] = {}
    for name, value in flatten(prior).items():
        if name not in KNOWN:
            raise unknown("parameter", name, KNOWN, "prior")
        free[name] = usual(name, vehicle) if value == USUAL else _boxed(name, value)
    named = stated(prior)
    for p in itertools.chain(*map(_parameters_of, effects)):
        acts = reported if p.name in effects else shared
        if p.name not in named and (sensed is None or acts(p, sensed)):
            free[p.name] = usual(p.name, vehicle)
    settled = {name for p in free.values() for name in p.fields}
    settled |= set() if sensed is None else {*unused(drive, model, sensed)}
    free |= {name: usual(name, vehicle) for name in vehicle.missing(model) if name not in settled}
    if not free:
        raise InputError("prior: no parameter is free; state at least one as name: [low, high]")
    space = ParameterSpace(tuple(free.values()))
    _check_physical(space, vehicle)
    return space


def _parameters_of(effect: str) -> Sequence[Parameter]:
    """Of an effect of the catalogue, or the one parameter of an effect that is named."""
    if effect in EFFECT_PARAMETERS:
        return [EFFECT_PARAMETERS[effect]]
    if effect not in CATALOGUE:
        raise unknown("effect", effect, CATALOGUE, "effects")
    return CATALOGUE[effect].parameters


def _check_physical(space: ParameterSpace, vehicle: Vehicle) -> None:
    """Refuse a box that reaches to negative constants or puts the centre of gravity behind the rear axle."""
    free = {p.name: p for p in space.parameters}
    wheelbase, l_f = (free["L"].low if "L" in free else vehicle.L), (free["l_f"].high if "l_f" in free else vehicle.l_f)
    if wheelbase is not None and l_f is not None and l_f >= wheelbase:
        raise InputError(f"prior: l_f up to {l_f:g} m reaches past the wheelbase {wheelbase:g} m")
    for p in space.parameters:
        for name in p.fields:
            if name not in {**GENERIC_PRIORS, **BODY_PRIORS}:
                continue
            nominal = getattr(vehicle, name) if p.relative else 0.0
            if nominal is None:
                raise InputError(f"prior: {p.name} is an offset, but vehicle '{vehicle.name}' states no {name}")
            lowest = nominal + p.scale * p.low
            if lowest <= 0:
                raise InputError(
                    f"prior: {p.name} = [{p.low:g}, {p.high:g}] reaches {name} = {lowest:g}; it must be positive"
                )
