"""Finite-strain laws against finite differences, their symmetries and their small-strain limits."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.materials import Kinematics, Law, Tangent, make_law
from tests.verification.records import Verified

Array = np.ndarray

FIBRE = (1.0, -2.0, 0.5)
LAWS = {
    "neo-hookean": make_law("neo-hookean", 5.2, 2.0, None, 1.0),
    "transversely-isotropic": make_law("transversely-isotropic", 5.2, 2.0, FIBRE, 6.0),
}
SHAPES = {
    "mooney-rivlin": {"second_share": 0.3},
    "yeoh": {"second_ratio": 0.7, "third_ratio": 0.4},
    "fung": {"exponent": 1.8},
    "ogden": {"exponents": (1.3, 5.0, -2.0), "shares": (0.5, 0.2, 0.3)},
}
LAWS |= {name: make_law(name, 5.2, 2.0, None, 1.0, shape) for name, shape in SHAPES.items()}
laws = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())


def _gradients(count: int = 20, size: float = 0.25) -> tuple[Array, Array]:
    """Random displacement gradients with det F > 0, and pressures."""
    rng = np.random.default_rng(3)
    h = rng.uniform(-size, size, (count, 3, 3))
    assert np.linalg.det(h + np.eye(3)).min() > 0.2
    return h, rng.uniform(-3.0, 3.0, count)


def _derivative(f: Callable[[Array], Array], h: Array, step: float = 1e-5) -> Array:
    """(..., 3, 3) central differences of f with respect to the components of h, the last two axes."""
    columns = []
    for k in range(3):
        for m in range(3):
            d = np.zeros((3, 3))
            d[k, m] = step
            columns.append((f(h + d) - f(h - d)) / (2.0 * step))
    out = np.stack(columns, axis=-1)
    return out.reshape(*out.shape[:-1], 3, 3)


def _dense(k: Kinematics, t: Tangent) -> Array:
    """(n, 3, 3, 3, 3) dP_iJ / dF_kL from the factors."""
    inverse = np.linalg.inv(k.gradient + np.eye(3))
    metric = np.broadcast_to(t.metric, inverse.shape)
    out = np.einsum("ik,nJL->niJkL", np.eye(3), metric)
    out += np.einsum("n,nJk,nLi->niJkL", t.crossed, inverse, inverse)
    out += np.einsum("n,nJi,nLk->niJkL", t.dilational, inverse, inverse)
    if t.elasticity is not None:
        voigt = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
        whole = t.elasticity[:, voigt[:, :, None, None], voigt]
        f = k.gradient + np.eye(3)
        out += np.einsum("niI,nIJKL,nkK->niJkL", f, whole, f)
    return out


by_differences = pytest.mark.anchor("stress and tangent at 20 random F", "central differences")


@by_differences
@laws
def test_stress_is_the_derivative_of_the_energy(
    law: Law, verified: Verified, request: pytest.FixtureRequest
) -> None:
    h, p = _gradients()

    def potential(h: Array) -> Array:
        return law.energy(Kinematics(h)) - p * (np.linalg.det(h + np.eye(3)) - 1.0)

    stress = law.stress(Kinematics(h), p)
    difference = (stress - _derivative(potential, h)) / np.abs(stress).max()
    verified.at_most(f"{request.node.callspec.id}: P less dW/dF, over the largest P", difference, 1e-8)


@by_differences
@laws
def test_tangent_is_the_derivative_of_the_stress(
    law: Law, verified: Verified, request: pytest.FixtureRequest
) -> None:
    h, p = _gradients()
    k = Kinematics(h)
    dense = _dense(k, law.tangent(k, p))
    expected = _derivative(lambda h: law.stress(Kinematics(h), p), h)
    difference = (dense - expected) / np.abs(dense).max()
    verified.at_most(f"{request.node.callspec.id}: A less dP/dF, over the largest A", difference, 1e-8)
    assert_allclose(dense, dense.transpose(0, 3, 4, 1, 2), rtol=1e-12, atol=1e-12)


@laws
def test_a_rotation_of_the_deformed_body_turns_the_stress_along(law: Law) -> None:
    h, p = _gradients()
    turn, _ = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    turned = Kinematics(turn @ (h + np.eye(3)) - np.eye(3))
    assert_allclose(law.stress(turned, p), turn @ law.stress(Kinematics(h), p), rtol=1e-11, atol=1e-12)
    assert_allclose(law.energy(turned), law.energy(Kinematics(h)), rtol=1e-11, atol=1e-13)


@laws
@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-9, 1e-12])
def test_small_strains_keep_their_digits(law: Law, size: float) -> None:
    """P -> 2 G eps - p I (+ k (a.eps a) a x a), with an error of first order in the size and no rounding noise."""
    h, p = _gradients()
    h, p = h * size, p * size
    eps = 0.5 * (h + h.swapaxes(1, 2))
    stress = 4.0 * eps - p[:, None, None] * np.eye(3)
    energy = 2.0 * np.einsum("nij,nij->n", eps, eps)
    if law.fibre is not None:
        a = np.array(FIBRE) / np.linalg.norm(FIBRE)
        along = np.einsum("i,nij,j->n", a, eps, a)
        stress += 5.0 * 5.2 * along[:, None, None] * np.outer(a, a)
        energy += 0.5 * 5.0 * 5.2 * along**2
    k = Kinematics(h)
    slack = 10.0 * size + 1e-13
    assert_allclose(law.stress(k, p), stress, rtol=0, atol=slack * np.abs(stress).max())
    assert_allclose(law.energy(k), energy, rtol=0, atol=slack * energy.max())


def _curves(name: str, stretch: Array) -> tuple[Array, Array]:
    """Nominal stress of incompressible bodies in uniaxial and equibiaxial tension, as in textbooks; G = 2."""
    if name == "ogden":
        exponents, shares = (np.array(SHAPES[name][key])[:, None] for key in ("exponents", "shares"))
        moduli = 4.0 * shares / exponents
        one, two = stretch ** (exponents - 1.0), [stretch ** (b * exponents - 1.0) for b in (-0.5, -2.0)]
        return (moduli * (one - two[0])).sum(axis=0), (moduli * (one - two[1])).sum(axis=0)
    slopes = []
    for invariant in (stretch**2 + 2.0 / stretch - 3.0, 2.0 * stretch**2 + stretch**-4 - 3.0):
        first, second = np.ones_like(stretch), 0.0
        if name == "mooney-rivlin":
            first, second = 0.7 * first, 0.3
        if name == "yeoh":
            first = 1.0 + 1.4 * invariant + 1.2 * invariant**2
        if name == "fung":
            first = np.exp(1.8 * invariant)
        slopes.append((first, second))
    (w1, w2), (v1, v2) = slopes
    uniaxial = 2.0 * (stretch - stretch**-2) * (w1 + w2 / stretch)
    return uniaxial, 2.0 * (stretch - stretch**-5) * (v1 + v2 * stretch**2)


@pytest.mark.anchor(
    "incompressible tension curves", "Holzapfel 2000, Nonlinear Solid Mechanics, section 6.5; Ogden 1972"
)
@pytest.mark.parametrize("name", ["neo-hookean", *SHAPES])
def test_tension_of_incompressible_bodies(name: str, verified: Verified) -> None:
    """The pressure is what leaves the free faces without load."""
    stretch = np.array([0.6, 0.8, 0.99, 1.0, 1.01, 1.2, 1.5, 2.0])
    law = LAWS[name]
    for title, other, expected in zip(
        ("uniaxial", "equibiaxial"), (stretch**-0.5, stretch), _curves(name, stretch), strict=True
    ):
        free = stretch**-0.5 if title == "uniaxial" else stretch**-2
        h = np.zeros((len(stretch), 3, 3))
        for i, value in enumerate((stretch, other, free)):
            h[:, i, i] = value - 1.0
        k = Kinematics(h)
        # P_33 = P_33(0) - p J / l_3
        pressure = law.stress(k, np.zeros(len(stretch)))[:, 2, 2] * free / (1.0 + k.dilation)
        found = law.stress(k, pressure)[:, 0, 0]
        verified.at_most(
            f"{name}, {title}: nominal stress over its largest",
            (found - expected) / np.abs(expected).max(),
            1e-12,
        )


def test_ogden_with_two_and_minus_two_is_mooney_rivlin() -> None:
    """At random deformations, and where two or three stretches are equal."""
    h, p = _gradients()
    h[0], h[1] = 0.2 * np.eye(3), np.diag([0.1, 0.1, -0.15])
    h[2] = 1e-9 * h[2]
    k = Kinematics(h)
    mooney = LAWS["mooney-rivlin"]
    ogden = make_law("ogden", 5.2, 2.0, None, 1.0, {"exponents": (2.0, -2.0), "shares": (0.7, 0.3)})
    assert_allclose(ogden.energy(k), mooney.energy(k), rtol=1e-11, atol=1e-15)
    assert_allclose(ogden.stress(k, p), mooney.stress(k, p), rtol=0, atol=1e-12)
    tangents = (_dense(k, law.tangent(k, p)) for law in (ogden, mooney))
    assert_allclose(*tangents, rtol=0, atol=1e-11)


def test_far_iterates_of_an_exponential_stay_finite() -> None:
    k = Kinematics(np.diag([60.0, 0.0, 0.0])[None])
    law = LAWS["fung"]
    assert np.isfinite(law.stress(k, np.zeros(1))).all()
    assert np.isfinite(law.tangent(k, np.zeros(1)).elasticity).all()
