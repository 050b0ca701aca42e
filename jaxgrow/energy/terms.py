"""Terms of the membrane's elasticity; add one by a line here."""

from jaxgrow.energy.area import Area
from jaxgrow.energy.bending import Bending
from jaxgrow.energy.finite_elements import FlowingSheet, Kirchhoff, NeoHookean
from jaxgrow.energy.healthy import HealthySprings
from jaxgrow.energy.springs import Springs
from jaxgrow.energy.tension import Tension
from jaxgrow.energy.term import MembraneTerm


MEMBRANE_TERMS: tuple[MembraneTerm, ...] = (
    Springs(),
    Bending(),
    Area(),
    Tension(),
    HealthySprings(),
    NeoHookean(),
    Kirchhoff(),
    FlowingSheet(),
)
