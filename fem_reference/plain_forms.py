"""The forms of the plain finite-strain problem, as a scikit-fem user writes them.

Total Lagrangian, mixed displacement-pressure form of the neo-Hookean solid (Bonet and Wood, Nonlinear Continuum
Mechanics, 2nd ed., eq. 6.27), F = I + H, H = grad u, J = det F, with fibres along a (Merodio and Ogden 2005, doi
10.1016/j.ijsolstr.2004.10.023) of modulus k and the pressure p on the surface with normal N:

    P : grad v  =  density g . v  -  p_contact (J F^-T N) . v     for all v
            q (J - 1) + (1/lambda) q p  =  0                       for all q
    P = G (F - F^-T) - p J F^-T + k/2 (a.C a - 1) (F a) x a,  C = F^T F

with lambda = 2 G nu / (1 - 2 nu), and q p = 0 where nu = 0: every Poisson ratio in (-1, 0.5] will do. The follower
pressure is that of Bonet and Wood, section 8.5.2.
"""

from __future__ import annotations

import numpy as np
from skfem import BilinearForm, Functional, LinearForm
from skfem.helpers import ddot, det, dot, grad, inv, mul, trace, transpose

# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators


def kinematics(H):
    """F^-T, J - 1 and C - I of displacement gradients (3, 3, ...), without the cancellation of F - I."""
    dilation = trace(H) + 0.5 * (trace(H) ** 2 - ddot(H, transpose(H))) + det(H)
    inverse = inv(H + np.eye(3)[:, :, None, None])
    return {
        "Fit": transpose(inverse),
        "dilation": dilation,
        "strain": H + transpose(H) + mul(transpose(H), H),
    }


def along(A, w):
    """A a, for the direction a of the fibres."""
    return mul(A, np.broadcast_to(w.a, A.shape[1:]))


def stress(w):
    """P."""
    P = mul(w.Fit, w.G * w.strain)  # G (F - F^-T) = F^-T G (C - I)
    P = P - w.p * (1.0 + w.dilation) * w.Fit
    return P + 0.5 * w.k * stretch(w) * w.Fa[:, None] * w.a[None, :]


def stretch(w):
    """a.C a - 1."""
    return dot(along(w.strain, w), w.a)


@LinearForm
def internal(v, w):
    return ddot(stress(w), grad(v))


@LinearForm
def volume_change(q, w):
    return (w.couples * w.dilation + w.gives * w.p) * q


@BilinearForm
def stiffness(u, v, w):
    du, dv = mul(grad(u), transpose(w.Fit)), mul(grad(v), transpose(w.Fit))  # grad u F^-1
    hydrostatic = w.p * (1.0 + w.dilation)
    shear = w.G * ddot(grad(u), grad(v)) + (w.G + hydrostatic) * ddot(du, transpose(dv))
    return shear - hydrostatic * trace(du) * trace(dv)


@BilinearForm
def fibre_stiffness(u, v, w):
    du, dv = along(grad(u), w), along(grad(v), w)
    return 0.5 * w.k * stretch(w) * dot(du, dv) + w.k * dot(w.Fa, du) * dot(w.Fa, dv)


@BilinearForm
def coupling(u, q, w):
    return q * (1.0 + w.dilation) * ddot(w.Fit, grad(u))


@BilinearForm
def mass(p, q, w):
    return w.gives * p * q


@LinearForm
def follower(v, w):
    return -w.contact * (1.0 + w.dilation) * dot(mul(w.Fit, w.n), v)


@BilinearForm
def follower_stiffness(u, v, w):
    turned = ddot(w.Fit, grad(u)) * w.Fit - mul(w.Fit, mul(transpose(grad(u)), w.Fit))
    return w.contact * (1.0 + w.dilation) * dot(mul(turned, w.n), v)


@Functional
def energy(w):
    """W + p^2 / (2 lambda), with I1 - 3 = tr(C - I)."""
    distortion = 0.5 * trace(w.strain) - np.log1p(w.dilation)
    W = w.G * distortion + 0.125 * w.k * stretch(w) ** 2
    return W + (0.5 * w.gives / w.couples * w.p**2 if w.couples else 0.0)


@Functional
def pressure_integral(w):
    """-tr(Cauchy stress) / 3 over the deformed body."""
    return -ddot(stress(w), w.F) / 3.0


@Functional
def volume(w):
    return 1.0 + w.dilation
