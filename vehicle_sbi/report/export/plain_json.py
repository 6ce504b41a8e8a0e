"""JSON: all that was identified, by our own names, for a program of the user's."""

import json
from dataclasses import asdict

from vehicle_sbi.report.export.car import UNITS, WITH_PAYLOAD, Car
from vehicle_sbi.report.export.exported import Exported, Inferred

SCHEMA = 1
CONVENTIONS = (
    "SI units; x ahead, y left, z up, angles positive to the left. Stiffnesses are AXLE values, both tyres together. "
    "constants: the car with the identified effects on it, a payload included where a note says so; those that are "
    "stated but were not identified are under stated, as the vehicle file has them."
)


def plain_json(known: Exported) -> dict[str, str]:
    """One file of everything."""
    content = {
        "schema": SCHEMA,
        "vehicle": known.vehicle,
        "from": {"kind": known.kind, "folder": str(known.folder), "version": known.version},
        "conventions": CONVENTIONS,
        "caveats": list(known.caveats),
        "parameters": {name: _plain(one) for name, one in known.identified.items()},
        "constants": _constants(known),
        "not_identified": list(known.not_identified),
        "why_not_identified": {name: known.inferred[name].why_not for name in known.not_identified},
        "stated": dict(known.stated),
    }
    return {"parameters.json": json.dumps(content, indent=2, allow_nan=False) + "\n"}


def _plain(one: Inferred) -> dict[str, object]:
    probability = {} if one.probability is None else {"probability": one.probability}
    averaged = {"averaged": True} if one.averaged else {}
    return {**asdict(one.estimate), **probability, **averaged}


def _constants(known: Exported) -> dict[str, dict[str, object]]:
    """Constants that an identified parameter has a part in, in SI units, with the parameters that they are from."""
    car, found = Car(known), dict[str, dict[str, object]]()
    for name in (name for name in UNITS if "." not in name):
        value = car.quantity(name)
        if value is not None and value.slopes:
            note = {"note": WITH_PAYLOAD} if car.has_payload(name) else {}
            found[name] = {**asdict(known.estimate(value)), "from": list(value.slopes), **note}
    return found
