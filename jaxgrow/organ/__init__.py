"""Organs on the host: built in or read, and the patch a lesion grows on."""

from jaxgrow.organ.enlarge import enlarge as enlarge, Enlargement as Enlargement
from jaxgrow.organ.loading import load_organ as load_organ
from jaxgrow.organ.merge import merge as merge, Merged as Merged
from jaxgrow.organ.organ import (
    locate_site as locate_site,
    Organ as Organ,
    room as room,
    Site as Site,
)
from jaxgrow.organ.patch import (
    cut_patch as cut_patch,
    Patch as Patch,
    widen_patch as widen_patch,
)
from jaxgrow.organ.patch_surface import (
    extend_lining as extend_lining,
    line_patch as line_patch,
    Lining as Lining,
)
from jaxgrow.organ.registry import (
    make_organ as make_organ,
    ORGANS as ORGANS,
    register_organ as register_organ,
)
from jaxgrow.organ.tissue import fill_tissue as fill_tissue, Tissue as Tissue
from jaxgrow.organ.uterus import uterus as uterus
from jaxgrow.organ.validity import OrganError as OrganError
from jaxgrow.organ.walls import walls_around as walls_around
