"""VDM formulations: each module assembles its own operator behind one interface."""

from vdm.formulations.base import Formulation
from vdm.formulations.boundary import BoundaryFormulation
from vdm.formulations.consistent import ConsistentFormulation
from vdm.formulations.mass_spring import MassSpringFormulation
from vdm.formulations.paper import PaperFormulation
from vdm.formulations.sparse import SparseFormulation
from vdm.formulations.vector import VectorFormulation

FORMULATIONS: dict[str, type[Formulation]] = {
    cls.name: cls
    for cls in (
        PaperFormulation,
        ConsistentFormulation,
        VectorFormulation,
        BoundaryFormulation,
        SparseFormulation,
        MassSpringFormulation,
    )
}
