"""Response of a structure with hysteretic springs, by an ODE solver with tight tolerances."""

import numpy as np
import numpy.typing as npt

from seft_plant_sim.specimen import Specimen

Floats = npt.NDArray[np.float64]

TOLERANCE = 1e-8
"""Of the solver, relative to the size of the response."""


def hysteretic_response(
    structure: Specimen, ground_motion: Floats, dt: float
) -> tuple[Floats, Floats, Floats]:
    """Displacement, velocity and force of the springs under ground motion, from rest.

    Parameters
    ----------
    structure : Specimen
        With springs; its mass is the whole structure's.
    ground_motion : ndarray
        Ground acceleration of each of the n axes by step, shape (N, n), m/s^2; linear in
        between.
    dt : float
        Period of a step, s.

    Returns
    -------
    displacement, velocity, force : ndarray
        Each of shape (N, n), in m, m/s and N (without damping).
    """
    from scipy.integrate import solve_ivp  # 20 MB that no node needs

    n, p = structure.axes, len(structure.springs)
    a, _ = structure.state_matrices()
    springs, deformation = structure.springs, structure.deformation
    share = np.linalg.solve(structure.mass, deformation.T)
    linear_stiffness = np.array([spring.stiffness for spring in springs])

    def spring_forces(x: Floats, z: Floats) -> Floats:
        each = zip(springs, (deformation @ x).tolist(), z.tolist(), strict=True)
        return np.array([spring.force(e, z_of) for spring, e, z_of in each])

    def slope(time: float, state: Floats, start: Floats, change: Floats) -> Floats:
        motion, z, work = state[: 2 * n], state[2 * n : 2 * n + p], state[2 * n + p :]
        x, v = motion[:n], motion[n:]
        rates = (deformation @ v).tolist()
        plastic = linear_stiffness * (deformation @ x) - spring_forces(x, z)
        result = np.empty_like(state)
        result[: 2 * n] = a @ motion
        result[n : 2 * n] += share @ plastic - (start + change * (time / dt))
        for j, (spring, rate) in enumerate(zip(springs, rates, strict=True)):
            result[2 * n + j] = spring.rate(float(z[j]), rate, float(work[j]))
            result[2 * n + p + j] = spring.work_rate(float(z[j]), rate)
        return result

    # what a spring yields by is the scale of its displacement; the mass's pace that of velocity
    pace = np.sqrt(np.linalg.norm(np.linalg.solve(structure.mass, structure.stiffness), 2))
    scale = min(spring.yield_displacement for spring in springs)
    size = np.concatenate(
        [np.full(n, scale), np.full(n, scale * pace), np.full(p, scale), np.full(p, 1.0)]
    )
    states = np.zeros((len(ground_motion), 2 * n + 2 * p))
    for step in range(len(ground_motion) - 1):
        start = ground_motion[step]
        solution = solve_ivp(
            slope,
            (0.0, dt),
            states[step],
            method="DOP853",
            args=(start, ground_motion[step + 1] - start),
            rtol=TOLERANCE,
            atol=TOLERANCE * size,
            first_step=dt,
        )
        state = solution.y[:, -1]
        for j, spring in enumerate(springs):
            state[2 * n + j] = spring.settle(float(state[2 * n + j]))
        states[step + 1] = state
    displacement, hysteretic = states[:, :n], states[:, 2 * n : 2 * n + p]
    pairs = zip(displacement, hysteretic, strict=True)
    forces = np.array([spring_forces(x, z) for x, z in pairs])
    elastic = structure.stiffness - deformation.T @ np.diag(linear_stiffness) @ deformation
    return displacement, states[:, n : 2 * n], forces @ deformation + displacement @ elastic.T
