# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
"""The model in JAX, one simulation that can be differentiated, and the paper's posterior by numpyro's NUTS.

Process noise on a stiffness adds to its parameter, so the likelihood needs their sum alone, as in `estimators.exact`.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm

from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.physics.vehicle import GRAVITY

jax.config.update("jax_enable_x64", True)
ROUNDS = 8  # of the loop between load transfer and longitudinal force, whose factor is below mu h / L = 0.2
SUMS = ("C_kappa_f", "C_kappa_r", "C_alpha_f", "C_alpha_r")
STEEPEST = 1.5  # [rad]


def regular(v):
    v = jnp.abs(v)
    return jnp.where(v >= 1.0, v, 0.5 * (1.0 + v * v))


def slip(rolling, v):
    return jnp.maximum((rolling - v) / regular(jnp.maximum(rolling, v)), -1.0)


def wheel_torque(torque, omega):
    fading = jnp.where(jnp.abs(omega) >= 1.0, jnp.sign(omega), omega * (2.0 - jnp.abs(omega)))
    return jnp.where(torque >= 0.0, torque, torque * fading)


def dugoff(C_kappa, C_alpha, mu, F_z, kappa, tan_alpha):
    x, y = C_kappa * kappa, C_alpha * tan_alpha
    demand, grip = jnp.sqrt(x * x + y * y + 1e-12), mu * jnp.maximum(F_z, 0.0)
    beyond = 0.5 * grip / demand * (2.0 - 0.5 * grip * (1.0 + kappa) / demand)
    factor = jnp.where(grip * (1.0 + kappa) >= 2.0 * demand, 1.0 / (1.0 + kappa), beyond)
    return x * factor, y * factor


def derivatives(p: Mapping[str, Any], u, x, guess):
    """Rates (9,), and a_x [m/s^2]."""
    (delta, torque_f, torque_r), (v_x, v_y, r, omega_f, omega_r, kappa_f, kappa_r, alpha_f, alpha_r) = u, x
    l_f, l_r, m = p["l_f"], p["L"] - p["l_f"], p["m"]
    load_f, load_r, lever = m * GRAVITY * l_r / p["L"], m * GRAVITY * l_f / p["L"], m * p["h_cog"] / p["L"]
    speed, v_yf, c, s = regular(v_x), v_y + l_f * r, jnp.cos(delta), jnp.sin(delta)
    tan_f, tan_r = (jnp.tan(jnp.clip(alpha, -STEEPEST, STEEPEST)) for alpha in (alpha_f, alpha_r))

    def forces(a_x):
        front = dugoff(p["C_kappa_f"], p["C_alpha_f"], p["mu"], load_f - lever * a_x, kappa_f, tan_f)
        rear = dugoff(p["C_kappa_r"], p["C_alpha_r"], p["mu"], load_r + lever * a_x, kappa_r, tan_r)
        return *front, *rear

    def again(a_x, _):
        F_xf, F_yf, F_xr, _ = forces(a_x)
        return (F_xf * c - F_yf * s + F_xr) / m, None

    a_x, _ = jax.lax.scan(again, guess, length=ROUNDS)  # written out, it takes minutes to compile
    F_xf, F_yf, F_xr, F_yr = forces(a_x)
    F_lateral = F_xf * s + F_yf * c
    R_f, R_r = (p["R_f"] - load / (6.0 * p["C_vert"]) for load in (load_f - lever * a_x, load_r + lever * a_x))
    fade_f, fade_r = speed * p["K"] / p["C_alpha_f"], speed * p["K"] / p["C_alpha_r"]
    rate = jnp.stack([
        a_x + v_y * r,
        (F_lateral + F_yr) / m - v_x * r,
        (l_f * F_lateral - l_r * F_yr) / (m * l_f * l_r),
        (wheel_torque(torque_f, omega_f) - F_xf * R_f) / p["I_wf"],
        (wheel_torque(torque_r, omega_r) - F_xr * R_r) / p["I_wr"],
        fade_f * (slip(R_f * omega_f, v_x * c + v_yf * s) - kappa_f),
        fade_r * (slip(R_r * omega_r, v_x) - kappa_r),
        fade_f * (delta - jnp.arctan(v_yf / speed) - alpha_f),
        fade_r * (-jnp.arctan((v_y - l_r * r) / speed) - alpha_r),
    ])  # fmt: skip
    return rate, a_x


def simulated(p: Mapping[str, Any], v_0, u, rate: float):
    """Series (5, time) driven by u (time, 3), a Runge-Kutta step a sample."""
    h, weight = 1.0 / rate, p["m"] * GRAVITY / p["L"]
    radius_f, radius_r = (p["R_f"] - weight * length / (6.0 * p["C_vert"]) for length in (p["L"] - p["l_f"], p["l_f"]))
    start = jnp.stack([
        v_0, 0.0, 0.0, v_0 * jnp.cos(u[0, 0]) / radius_f, v_0 / radius_r, 0.0, 0.0, u[0, 0], 0.0
    ])  # fmt: skip

    def step(carried, inputs):
        (x, guess), (now, following) = carried, inputs
        middle = 0.5 * (now + following)
        k1, a_x = derivatives(p, now, x, guess)
        k2, _ = derivatives(p, middle, x + 0.5 * h * k1, a_x)
        k3, _ = derivatives(p, middle, x + 0.5 * h * k2, a_x)
        k4, _ = derivatives(p, following, x + h * k3, a_x)
        sensed = jnp.stack([a_x, k1[1] + x[0] * x[2], x[2], x[3], x[4]])
        return (x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), a_x), sensed

    following = jnp.concatenate([u[1:], u[-1:]])
    _, y = jax.lax.scan(step, (start, jnp.asarray(0.0)), (u, following))
    return y.T


class Study:
    """The paper's study: its log posterior in (l_f, h_cog, four sums [1e5], initial speed)."""

    def __init__(self, simulator: Simulator, observed: np.ndarray) -> None:
        nominal, space, mixture = simulator.nominal, simulator.space, simulator.process.stiffness
        self.fixed = {name: float(nominal[name]) for name in ("m", "L", "mu", "R_f", "C_vert", "I_wf", "I_wr", "K")}
        self.u, self.rate = jnp.asarray(simulator.windows.u[0][:, [0, 1, 2]]), simulator.windows.rate
        self.observed = jnp.asarray(observed)
        self.share, self.floor = (jnp.asarray(x)[:, None] for x in (simulator.noise.share, simulator.noise.floor))
        self.nominal = np.array([float(nominal[name]) for name in SUMS])
        self.mean, self.std = np.array(mixture.means), np.array(mixture.stds)
        columns = [space.column(f"delta_{name}") for name in SUMS]
        free = [space.column(name) for name in ("l_f", "h_cog")]
        self.box, self.edges = (space.low[free], space.high[free]), (space.low[columns], space.high[columns])
        half = float(simulator.windows.x0_std[0]) * np.sqrt(3.0)
        self.v_0 = float(simulator.windows.x0[0, 0]) - half, float(simulator.windows.x0[0, 0]) + half

    def series(self, place, sums, v_0):
        stiff = {name: c + 1e5 * x for name, c, x in zip(SUMS, self.nominal, sums, strict=True)}
        return simulated({**self.fixed, **stiff, "l_f": place[0], "h_cog": place[1]}, v_0, self.u, self.rate)

    def model(self) -> None:
        """What numpyro samples."""
        import numpyro

        dist: Any = numpyro.distributions
        place = numpyro.sample("place", dist.Uniform(jnp.asarray(self.box[0]), jnp.asarray(self.box[1])).to_event(1))
        reach = 1e-5 * self.nominal * (self.mean.max() + 6.0 * self.std.max())
        low, high = jnp.asarray(self.edges[0] - reach), jnp.asarray(self.edges[1] + reach)
        sums: Any = numpyro.sample("sums", dist.Uniform(low, high).to_event(1))
        v_0 = numpyro.sample("v_0", dist.Uniform(*self.v_0))
        for name, x, c, lowest, highest in zip(SUMS, sums, 1e-5 * self.nominal, *self.edges, strict=True):
            smeared = norm.cdf((x - lowest - c * self.mean) / (c * self.std))
            smeared -= norm.cdf((x - highest - c * self.mean) / (c * self.std))
            numpyro.factor(f"prior_{name}", jnp.log(jnp.maximum(smeared.mean(), 1e-300)))
        y = self.series(place, sums, v_0)
        std = jnp.sqrt((self.share * y) ** 2 + self.floor**2)
        numpyro.factor("likelihood", jnp.sum(-0.5 * ((self.observed - y) / std) ** 2 - jnp.log(std)))

    def sampled(self, warm_up: int, kept: int, looks: int, seed: int) -> Iterator[dict[str, np.ndarray]]:
        """Draws (kept, ...) of each site of the model, `looks` times one after the other, by one chain of NUTS."""
        from numpyro.infer import MCMC, NUTS, init_to_median

        kernel = NUTS(self.model, init_strategy=init_to_median)
        chain = MCMC(kernel, num_warmup=warm_up, num_samples=kept, progress_bar=False)
        chain.warmup(jax.random.PRNGKey(seed))
        for _ in range(looks):
            state: Any = chain.last_state
            chain.post_warmup_state = state
            chain.run(state.rng_key)
            yield {name: np.asarray(values) for name, values in chain.get_samples().items()}
