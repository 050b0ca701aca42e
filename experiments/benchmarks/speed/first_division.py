"""Import jaxgrow, plant a polyp and let it divide once, as a script would.

    python -m speed.first_division "$(date +%s.%N)"

prints the seconds from the time given to the first division, and how many programs were
loaded and compiled. Nothing else is imported; JAX is configured by its variables.
"""

import json
import sys
import time
from collections import Counter

import jax

import jaxgrow as jg
from jaxgrow.growth.grow import grow  # not by name: what it stands for is imported here


HITS, MISSES = (f"/jax/compilation_cache/cache_{which}" for which in ("hits", "misses"))


if __name__ == "__main__":
    imports = time.time() - float(sys.argv[1])
    events = Counter[str]()
    jax.monitoring.register_event_listener(lambda name, **_: events.update([name]))
    polyp = jg.Polyp(divisions=1, particle_mm=1.0)
    planting = grow(jg.Scene(lesion=polyp), tolerance=1e-3).seconds["plant"]
    found = {
        "seconds": imports + planting,
        "imports": imports,
        "planting": planting,
        "loaded": events[HITS],
        "compiled": events[MISSES],
    }
    print(json.dumps(found))
