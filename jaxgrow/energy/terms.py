"""Terms of the membrane's elasticity; add one by a line here."""

from jaxgrow.energy.bending import Bending
from jaxgrow.energy.springs import Springs
from jaxgrow.energy.term import MembraneTerm


MEMBRANE_TERMS: tuple[MembraneTerm, ...] = (Springs(), Bending())
