"""The specimen of one axis that several coupled ones are compared with."""

from dataclasses import dataclass

import numpy as np

from seft_ros.identification.specimen_fit import SpecimenFit


@dataclass(frozen=True)
class NominalAxis:
    """Mass, damping and stiffness of one uncoupled axis, kg, N s/m and N/m."""

    mass: float
    damping: float
    stiffness: float

    @classmethod
    def of(cls, specimen: SpecimenFit) -> "NominalAxis":
        """Take the mean of the axes of a specimen, uncoupled."""
        return cls(
            *(
                float(matrix.diagonal().mean())
                for matrix in (specimen.mass, specimen.damping, specimen.stiffness)
            )
        )

    def on_each(self, axes: int) -> SpecimenFit:
        """Give the specimen that is one of it on each of n axes."""
        mass, damping, stiffness = (
            value * np.eye(axes) for value in (self.mass, self.damping, self.stiffness)
        )
        return SpecimenFit(mass, damping, stiffness, error=0.0)
