"""Of each claim: what the paper says in its place, how it is tried here, and what would change the verdict."""

from __future__ import annotations

from ..report.judgement import About

ABOUT = {
    1: About(
        "Model Assemblage, (19), (28) and (33): the fluid is incompressible, so the volume is kept at all "
        "times. The linear analysis is meant for small strains (below 10 %), the quasi-linear and nonlinear "
        "ones for any.",
        "Every solver of every form takes the load history of a deep push on a ball. The exact volume of "
        "the deformed polyhedron is compared with that at rest, never the solver's own sum.",
        "Other loads: the linear solver adds terms of second order by its definition, so that a smaller load "
        "within its range lowers its number.",
    ),
    2: About(
        "Linear Analysis and Quasi-Linear Analysis: the areas stay constant for small deformations and "
        "strains below 10 %, as in an echographic exam of the thigh.",
        "Linear and finite-strain elements on the same mesh show where small strain ends, as the load "
        "grows. The thigh under a probe is one of the scenes.",
        "A scene whose linear elements depart by 5 % below a strain of 10 %, or a linear VDM within 10 % "
        "there.",
    ),
    3: About(
        "Conclusion: a surface model's complexity is one order of magnitude below that of a volumetric one.",
        "The printed form and linear elements on the same mesh take turns, in one thread. Set-up and frame "
        "are timed apart; elements condensed to the surface are the third runner.",
        "Other meshes, another machine, or another factorisation of the elements.",
    ),
    4: About(
        "Conclusion: VDM is not very accurate, but at small time-steps its results are like those of FEM.",
        "The same load is applied in one step and in many, by the quasi-linear, the nonlinear and the incremental "
        "solver; the reference is of finite strain. The first two solve for the whole displacement in each step. "
        "The third reads the figures: each step moves the nodes, and areas, normals and matrix are rebuilt.",
        "A load, a body or moduli whose error at small steps is not that of one step.",
    ),
    5: About(
        "Nonlinear Analysis, Figure 8: with the last displacement as first guess the iterations are far "
        "fewer.",
        "Bi-conjugate gradients run load histories of several lengths, started from the last solution and "
        "from zero, to the same tolerance, which goes from loose to tight. The matrix is scaled, so that the units "
        "of its rows decide nothing.",
        "A longer history or a looser tolerance, with which the gain grows; a state matrix in the units in which "
        "it is printed, whose cold start takes longer.",
    ),
    6: About(
        "Conclusion: a liver, being 95 % blood, needs only the density and the bulk modulus of blood.",
        "B and B_ij take values from a tenth of the tissue's shear modulus to the bulk modulus of blood, on "
        "a ball under a fingertip. The largest displacement is held against the reference's.",
        "A tissue whose reference moves as little as a body of 2.2 GPa.",
    ),
    7: About(
        "Imposing Constraints, anisotropic: B_i and B_ij are tuned so that the body deforms along its "
        "fibres.",
        "Fibres along x make the body stiffer in the reference and, by direction, in the moduli of the "
        "skin. The ratio of mean strains across and along is compared.",
        "Another way from fibres to moduli that turns the ratio as the reference does in every case.",
    ),
    8: About(
        "System Resolution and Conclusion: the nonlinear method solves large deformations and strains "
        "without much loss of accuracy.",
        "Nonlinear forms and finite-strain elements take the same growing load. The error at full load is "
        "compared with the error at the smallest.",
        "A larger load, at which an error grows or a solver stops.",
    ),
    9: About(
        "System Resolution: a static resolution does not suffer from the instabilities of dynamic systems.",
        "Every solver of the printed form meets moduli sixteen orders of magnitude apart, and is held "
        "against the direct answer. The page on numerical stability tries slivers, sizes and supports.",
        "A step that is called converged and is wrong.",
    ),
}
