"""Metrics of a lesion's shape, as differentiable scalars with units."""

from jaxgrow.metrics.elevation import height_above as height_above
from jaxgrow.metrics.registry import (
    measure as measure,
    metric_names as metric_names,
    register_metric as register_metric,
)
from jaxgrow.metrics.shape import (
    shape_metrics as shape_metrics,
    ShapeMetrics as ShapeMetrics,
)
