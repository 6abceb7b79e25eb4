"""Finite-strain laws of the mixed displacement-pressure element: energy, stress, tangent, in that order.

F = I + H is the deformation gradient, H the displacement gradient, J = det F, C = F^T F, I1 = tr C, p the pressure
field, lambda = 2 G nu / (1 - 2 nu). Every law is used in the two-field form

    Psi(F, p) = W(F) - p (J - 1) - p^2 / (2 lambda),    so that p = -lambda (J - 1) holds weakly,

It is finite for every Poisson ratio in (-1, 0.5]. Its small-strain limit is the linear element's, stress = 2 G
eps - p I with p = -lambda div u. A law gives W and the derivatives of W - p (J - 1). It takes H instead of F,
because F - I and J - 1 by subtraction would lose the digits of small strains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from fem_reference.hyperelastic import FungDemiray, MooneyRivlin, Ogden, Yeoh
from fem_reference.kinematics import PAIRS, Kinematics, Law, Tangent, less_logarithm, product
from solver_common.arrays import Array
from solver_common.solution import solver_error

# each material with its dimensionless parameters; sums are one where the moduli add up to G
PARAMETERS: dict[str, tuple[str, ...]] = {
    "neo-hookean": (),
    "transversely-isotropic": (),
    "mooney-rivlin": ("second_share",),
    "yeoh": ("second_ratio", "third_ratio"),
    "fung": ("exponent",),
    "ogden": ("exponents", "shares"),
}
MATERIALS = tuple(PARAMETERS)
_RANGES: dict[str, tuple[Callable[[Array], bool], str]] = {
    "second_share": (lambda v: bool(0.0 <= v <= 1.0), "a number from 0 to 1"),
    "second_ratio": (lambda v: bool(v >= 0.0), "a number that is not negative"),
    "third_ratio": (lambda v: bool(v >= 0.0), "a number that is not negative"),
    "exponent": (lambda v: bool(v > 0.0), "a positive number"),
    "exponents": (lambda v: bool(v.all()), "numbers other than zero"),
    "shares": (lambda v: bool((v > 0.0).all() and abs(v.sum() - 1.0) < 1e-9), "positive numbers, sum 1"),
}


@dataclass(frozen=True)
class NeoHookean:
    """Neo-Hookean solid (Bonet and Wood, Nonlinear Continuum Mechanics, 2nd ed., eq. 6.27).

    W = G/2 (I1 - 3 - 2 ln J)
    P = G (F - F^-T) - p J F^-T
    dP/dF : dF = G dF + (G + p J) F^-T dF^T F^-T - p J (F^-T : dF) F^-T

    Attributes
    ----------
    shear_modulus : G, positive
    """

    shear_modulus: float

    @property
    def fibre(self) -> Array | None:
        """None: isotropic."""
        return None

    def energy(self, k: Kinematics) -> Array:
        """(...,) W; see `Law`."""
        # (I1 - 3)/2 - ln J = |H|^2/2 - (J - 1 - tr H) + (J - 1 - ln J): each term of second order.
        squares = np.einsum("...ij,...ij->...", k.gradient, k.gradient)
        return self.shear_modulus * (0.5 * squares - k.minors + less_logarithm(k.dilation))

    def stress(self, k: Kinematics, pressure: Array) -> Array:
        """(..., 3, 3) P; see `Law`."""
        # F - F^-T = F^-T (C - I)
        inner = self.shear_modulus * k.doubled_strain
        hydrostatic = pressure * (1.0 + k.dilation)
        for i in range(3):
            inner[..., i, i] -= hydrostatic
        return product(np.swapaxes(k.inverse, -1, -2), inner)

    def tangent(self, k: Kinematics, pressure: Array) -> Tangent:
        """dP/dF; see `Law`."""
        hydrostatic = pressure * (1.0 + k.dilation)
        return Tangent(self.shear_modulus * np.eye(3), self.shear_modulus + hydrostatic, -hydrostatic)


@dataclass(frozen=True)
class TransverselyIsotropic:
    """Neo-Hookean solid with one family of fibres along a, the standard reinforcing model.

    W = W_neo-Hookean + k/8 (I4 - 1)^2,  I4 = a.C a    (Merodio and Ogden 2005, doi 10.1016/j.ijsolstr.2004.10.023)
    P = P_neo-Hookean + k/2 (I4 - 1) (F a) x a
    dP/dF : dF = ... + k/2 (I4 - 1) (dF a) x a + k (F a . dF a) (F a) x a

    At small strain the fibres add k (a.eps a) a x a to the stress: Young's modulus along them is E + k, whatever
    the Poisson ratio.

    Attributes
    ----------
    matrix : the isotropic part
    fibre_modulus : k, not negative
    direction : a, a unit vector
    """

    matrix: NeoHookean
    fibre_modulus: float
    direction: tuple[float, float, float]

    @property
    def fibre(self) -> Array:
        """(3,) a."""
        return np.array(self.direction)

    @property
    def small_strain(self) -> Array:
        """(3, 3) M: the fibres add M (M : eps) to the stress at small strain."""
        return np.sqrt(self.fibre_modulus) * np.outer(self.fibre, self.fibre)

    def energy(self, k: Kinematics) -> Array:
        """(...,) W; see `Law`."""
        return self.matrix.energy(k) + 0.125 * self.fibre_modulus * self._stretch(k) ** 2

    def stress(self, k: Kinematics, pressure: Array) -> Array:
        """(..., 3, 3) P; see `Law`."""
        tension = 0.5 * self.fibre_modulus * self._stretch(k)
        along = (k.deformation_gradient @ self.fibre) * tension[..., None]
        return self.matrix.stress(k, pressure) + along[..., :, None] * self.fibre

    def tangent(self, k: Kinematics, pressure: Array) -> Tangent:
        """dP/dF; see `Law`."""
        base = self.matrix.tangent(k, pressure)
        tension = 0.5 * self.fibre_modulus * self._stretch(k)
        metric = base.metric + tension[..., None, None] * np.outer(self.fibre, self.fibre)
        first, second = PAIRS
        dyad = self.fibre[first] * self.fibre[second]
        elasticity = np.broadcast_to(self.fibre_modulus * np.outer(dyad, dyad), (*tension.shape, 6, 6))
        return Tangent(metric, base.crossed, base.dilational, elasticity)

    def _stretch(self, k: Kinematics) -> Array:
        """(...,) I4 - 1."""
        return np.asarray((k.doubled_strain @ self.fibre) @ self.fibre)


def make_law(
    material: str,
    youngs_modulus: float,
    shear_modulus: float,
    fibre_direction: ArrayLike | None,
    contrast: float,
    parameters: Mapping[str, ArrayLike] | None = None,
) -> Law:
    """The law by name, with the given moduli at small strain.

    Parameters
    ----------
    material : one of `MATERIALS`
    youngs_modulus, shear_modulus : of the isotropic part [Pa]
    fibre_direction : (3,), any length; for the transversely isotropic law only
    contrast : Young's modulus along the fibres over that of the isotropic part, 1 or more
    parameters : those in `PARAMETERS`. Mooney-Rivlin: second_share = c2/(c1 + c2), in [0, 1]. Yeoh: second_ratio =
        c2/c1 and third_ratio = c3/c1, not negative. Fung-Demiray: exponent b, positive. Ogden: exponents a_p, none
        zero, and the shares m_p a_p / (2 G), positive, sum 1

    Raises
    ------
    SolverError
        For an unknown name, parameters that are not the law's or out of range, a direction of no length, or a
        contrast below one.
    """
    if material not in MATERIALS:
        raise _bad_material(f"material {material!r} is unknown", f"use one of {', '.join(MATERIALS)}")
    values = _checked_parameters(material, parameters or {})
    if material == "transversely-isotropic":
        return _with_fibres(NeoHookean(shear_modulus), youngs_modulus, fibre_direction, contrast)
    if fibre_direction is not None or contrast != 1.0:
        raise _bad_material(f"a {material} body has no fibres", 'use material="transversely-isotropic"')
    if material == "mooney-rivlin":
        share = values["second_share"].item()
        return MooneyRivlin(0.5 * shear_modulus * (1.0 - share), 0.5 * shear_modulus * share)
    if material == "yeoh":
        c1, second, third = 0.5 * shear_modulus, values["second_ratio"].item(), values["third_ratio"].item()
        return Yeoh(c1, c1 * second, c1 * third)
    if material == "fung":
        return FungDemiray(shear_modulus, values["exponent"].item())
    if material == "ogden":
        exponents = values["exponents"]
        moduli = 2.0 * shear_modulus * values["shares"] / exponents
        return Ogden(tuple(moduli.tolist()), tuple(exponents.tolist()))
    return NeoHookean(shear_modulus)


def _with_fibres(
    matrix: NeoHookean, youngs_modulus: float, fibre_direction: ArrayLike | None, contrast: float
) -> TransverselyIsotropic:
    if fibre_direction is None:
        raise _bad_material("there is no fibre_direction", "give the direction of the fibres")
    direction = np.asarray(fibre_direction, dtype=np.float64)
    length = float(np.linalg.norm(direction)) if direction.shape == (3,) else 0.0
    if not (np.isfinite(length) and length > 0.0):
        raise _bad_material(
            f"fibre_direction {direction.tolist()} is no direction", "give three numbers, not all zero"
        )
    if not (np.isfinite(contrast) and contrast >= 1.0):
        raise _bad_material(f"contrast is {contrast}", "give 1 or more: fibres stiffen the body")
    x, y, z = (direction / length).tolist()
    return TransverselyIsotropic(matrix, (contrast - 1.0) * youngs_modulus, (x, y, z))


def _checked_parameters(material: str, given: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """The parameters as arrays, all of them and no others, each in its range."""
    wanted = PARAMETERS[material]
    unknown = sorted(set(given) - set(wanted))
    if unknown:
        remedy = f"give {' and '.join(wanted)}" if wanted else "leave it out"
        raise _bad_material(f"a {material} body has no parameter {unknown[0]!r}", remedy)
    absent = [name for name in wanted if name not in given]
    if absent:
        raise _bad_material(f"there is no {absent[0]} of a {material} body", f"give {' and '.join(wanted)}")
    values = {name: np.asarray(given[name], dtype=np.float64) for name in wanted}
    for name, value in values.items():
        listed = name in ("exponents", "shares")
        if value.ndim != (1 if listed else 0) or not value.size or not np.isfinite(value).all():
            raise _bad_material(
                f"{name} is {value.tolist()}", "give a list of numbers" if listed else "give one number"
            )
    for name, value in values.items():
        fits, range_ = _RANGES[name]
        if not fits(value):
            raise _bad_material(f"{name} is {value.tolist()}", f"give {range_}")
    if material == "ogden" and len(values["exponents"]) != len(values["shares"]):
        raise _bad_material("exponents and shares are not equally many", "give one share for each exponent")
    return values


_bad_material = partial(solver_error, "bad-material")
