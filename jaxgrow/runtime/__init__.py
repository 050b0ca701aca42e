"""Ground layer: results, types, caches, timers and warnings."""
