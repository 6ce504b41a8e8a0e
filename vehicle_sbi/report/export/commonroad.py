"""CommonRoad's vehicle models: a folder that `setup_vehicle_parameters(vehicle_id=5, dir_params=FOLDER)` reads.

Its tyres have one coefficient for both axles, stiffness over load: an axle's stiffness is -p_ky1 F_z across and
p_kx1 F_z along (vehicle_dynamics_st.py, where mu C_S = -p_ky1), so here they are the sums over both axles over m g.
"""

from vehicle_sbi.physics.vehicle import GRAVITY
from vehicle_sbi.report.export.car import Car, Entry
from vehicle_sbi.report.export.exported import Exported
from vehicle_sbi.report.export.writing import has_identified, head, left_over, yaml_file

VEHICLE_ID = 5  # CommonRoad's own end at 4
ONE_COEFFICIENT = (
    "WARNING: CommonRoad has ONE stiffness coefficient for both axles. p_ky1 and p_kx1 keep the sum of the axles' "
    "stiffnesses, not how it is shared."
)
CENTRE = (
    "a, b and h_cg are of the whole car's centre of gravity. CommonRoad takes a and b as of the sprung mass, and its "
    "single-track model reads the height h_s of that mass, which is not written."
)
PARTIAL = "Keys that are not here are None to CommonRoad: merge these files over a complete set."


def commonroad(known: Exported) -> dict[str, str]:
    """The vehicle's file and its tyres', without the keys that are not known."""
    car = Car(known)
    body, tyres = _body(car), _tyres(car)
    if not has_identified([*body, *tyres]):
        return {}
    end = left_over(known, [*body, *tyres])
    first = head("CommonRoad, vehiclemodels: the vehicle", known, (CENTRE, PARTIAL))
    second = head("CommonRoad, vehiclemodels: the tyres", known, (ONE_COEFFICIENT, PARTIAL))
    return {
        f"parameters_vehicle{VEHICLE_ID}.yaml": yaml_file(known, [*first, *end], (), body),
        "parameters_tire.yaml": yaml_file(known, [*second, *end], ("tire",), tyres),
    }


def _body(car: Car) -> list[Entry]:
    wheel = "of one wheel, half the front axle's"
    return [
        car.same("m", "m"),
        car.same("a", "l_f"),
        car.entry("b", "m", lambda L, l_f: L - l_f, "L", "l_f"),
        car.same("I_z", "I_z", "m l_f l_r where no I_z is stated"),
        car.same("h_cg", "h_cog"),
        car.same("T_f", "track_f"),
        car.same("T_r", "track_r"),
        car.same("m_s", "m_s"),
        car.same("I_Phi_s", "I_x"),
        car.same("I_y_s", "I_y"),
        car.same("R_w", "R_f", "free radius; CommonRoad means the rolling one"),
        car.entry("I_y_w", "kg m^2", lambda I_wf: 0.5 * I_wf, "I_wf", note=wheel),
    ]


def _tyres(car: Car) -> list[Entry]:
    return [
        car.same("p_dy1", "mu", "peak of the friction across"),
        car.entry("p_ky1", "1", _across, "C_alpha_f", "C_alpha_r", "m", note=_by_axle(car, "alpha", -1.0)),
        car.entry("p_kx1", "1", _along, "C_kappa_f", "C_kappa_r", "m", note=_by_axle(car, "kappa", 1.0)),
    ]


def _along(C_kappa_f: float, C_kappa_r: float, m: float) -> float:
    return (C_kappa_f + C_kappa_r) / (m * GRAVITY)


def _across(C_alpha_f: float, C_alpha_r: float, m: float) -> float:
    return -(C_alpha_f + C_alpha_r) / (m * GRAVITY)


def _by_axle(car: Car, way: str, sign: float) -> str:
    """Each axle's own coefficient, in words."""
    front, rear, m, L, l_f = (car.quantity(name) for name in (f"C_{way}_f", f"C_{way}_r", "m", "L", "l_f"))
    if front is None or rear is None or m is None or L is None or l_f is None:
        return ""
    weight = m.mean * GRAVITY / L.mean
    own = (front.mean / (weight * (L.mean - l_f.mean)), rear.mean / (weight * l_f.mean))
    return f"front axle alone {sign * own[0]:.4g}, rear alone {sign * own[1]:.4g}"
