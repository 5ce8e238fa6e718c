"""All plants by their letters."""

from collections.abc import Mapping

from trueangle_training.plant.mechanical.world import PLANT as MECHANICAL
from trueangle_training.plant.metrological.world import PLANT as METROLOGICAL
from trueangle_training.plant.reading_head.world import PLANT as READING_HEAD
from trueangle_training.plant.world import Plant

PLANTS: Mapping[str, Plant] = {plant.letter: plant for plant in (READING_HEAD, MECHANICAL, METROLOGICAL)}
