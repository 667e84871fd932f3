"""The resampling schemes that a job can name. Data only: this imports no Numba."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Scheme:
    """A resampling scheme.

    Parameters
    ----------
    name : str
        As job files name it.
    description : str
        The scheme in one line.
    sorts : bool
        Whether the particles are sorted by their states first.
    """

    name: str
    description: str
    sorts: bool = False


MULTINOMIAL = Scheme("multinomial", "Independent ancestors, as in the paper.")
STRATIFIED = Scheme("stratified", "One point in each of as many strata as there are particles.")
SYSTEMATIC = Scheme("systematic", "Equidistant points with one common random shift.")
RESIDUAL = Scheme("residual", "The whole part of each expected number; the rest is multinomial.")
SORTED_SYSTEMATIC = Scheme(
    "sorted_systematic", "Systematic, with the particles sorted by their states.", sorts=True
)
SCHEMES = {
    scheme.name: scheme
    for scheme in (MULTINOMIAL, STRATIFIED, SYSTEMATIC, RESIDUAL, SORTED_SYSTEMATIC)
}
