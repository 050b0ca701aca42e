"""Small tools of array programs: guarded formulas, bit masks, capacities."""
