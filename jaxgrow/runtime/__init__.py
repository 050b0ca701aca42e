"""What every layer may use: results, types, caches, timers, warnings."""
