"""Everything the algorithms need to know about a map, computed when first asked for."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.features.budget import (
    check_budget,
    features_bytes,
    ray_distances_bytes,
    surface_count,
)
from imgloc.features.distance import (
    DRAWN,
    RUN,
    UNIT,
    DistanceField,
    distance_field,
    distance_image,
    peeled,
    straight_share,
    wall_thickness,
    whole_steps,
)
from imgloc.features.fields import bmap, vmap
from imgloc.features.gradients import SOURCES, vmap_of_image
from imgloc.features.pyramid import Level, any_of_blocks, coarse_info, pyramid
from imgloc.features.raycast import Distances
from imgloc.features.raydistance import LONGEST, ray_distances
from imgloc.features.surface import surface_points
from imgloc.features.visibility import WAYS, visibility_frames
from imgloc.model import BoolArray, Float32Array, GridInfo, OccupancyGrid, OrientedPoints
from imgloc.options import CellSide, Length
from imgloc.ranges import Checked, Count, OneOf, Within

#: A map with more cells keeps its walls as they are: each thinner copy has features of its own.
PEELED_CELLS = 6_000_000
#: A map with more cells has thinner copies made when an answer first needs them: 0.1 s each.
AHEAD_CELLS = 2_000_000
#: With more cells than this at four times `cell`, the search starts at eight times.
COARSE_CELLS = 1 << 17

# The C library returns the end of its memory to the system whenever twice the largest block so far,
# up to 32 MB, is free there, and fetches it anew for the next step. So such a block is freed first.
np.empty((1 << 25) - (1 << 16), np.uint8)


@dataclass(frozen=True, eq=False)
class MapFeatures(Checked):
    """The features of one map; each is computed once, when first used, and read-only.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    cell : float
        Side of a cell in the lattice of poses, in bmap, vmap and the ray-distance stack, metres;
        rounded to a multiple of the map's own cells.
    sigma, sigma_endpoint : float
        Standard deviations, metres: of the kernel K that blurs bmap and vmap, and of an endpoint's
        distance from its wall in the pyramid.
    vmap_from : {"image", "contours"}
        What makes CBML-O's vector field: :func:`~imgloc.features.gradients.vmap_of_image`, or
        the normals of the surface points by :func:`~imgloc.features.fields.vmap`.
    n_psi, horizon, visibility_by : int, float, str
        Directions, reach in metres and way of the visibility map, see
        :func:`~imgloc.features.visibility.visibility_frames`.
    n_rays, max_range : int, float
        Directions of the ray-distance stack, and its value where a ray hits nothing, metres.
    memory_budget : int, optional
        Bytes; a larger ray-distance stack is refused. None is half of the available RAM.
    threads : int
        Used for the ray-distance stack; no result depends on it.

    Raises
    ------
    ConfigError
        If a value is out of its range.

    Examples
    --------
    >>> walls = np.zeros((20, 30), bool)
    >>> walls[[2, -3]] = True
    >>> features = MapFeatures(OccupancyGrid(walls, ~walls, 0.1), sigma=0.1)
    >>> features.bmap.shape, features.vmap.shape, features.visibility.shape[0]
    ((20, 30), (2, 20, 30), 72)
    """

    grid: OccupancyGrid
    cell: CellSide = 0.1
    sigma: Length = 0.1
    sigma_endpoint: Length = 0.15
    vmap_from: Annotated[str, OneOf(*SOURCES)] = "image"
    n_psi: Annotated[int, Within(1, 3600, "directions")] = 72
    horizon: Length = 30.0
    visibility_by: Annotated[str, OneOf(*WAYS)] = "march"
    n_rays: Count = 360
    max_range: Annotated[float, Within(0.01, LONGEST, "metres")] = 30.0
    memory_budget: Count | None = None
    threads: Count = 1

    @cached_property
    def lattice(self) -> GridInfo:
        """The lattice of poses: shares its corner with the map, covers all of it."""
        return coarse_info(self.grid.info, self.factor)

    @cached_property
    def free(self) -> BoolArray:
        """Lattice cells in which a free cell of the map lies: the pose space, (H, W) bool."""
        return read_only(any_of_blocks(self.grid.free, self.factor))

    @property
    def factor(self) -> int:
        """Cells of the map along a cell in the lattice of poses."""
        return max(1, round(self.cell / self.grid.resolution))

    @cached_property
    def field(self) -> DistanceField:
        """Signed distance to the surfaces, at the map's own resolution."""
        walls = np.asarray(self.walls, np.float32) if self.peels else None
        return distance_field(self.grid.occupied, self.grid.resolution, walls)

    @cached_property
    def walls(self) -> Distances:
        """Distance to the nearest occupied cell, in cells, for casting rays.

        (H, W) float32; on very large maps (see :attr:`peels`) bytes of whole cells, at most 255.
        """
        return read_only((distance_image if self.peels else whole_steps)(self.grid.occupied))

    @property
    def furnished(self) -> "MapFeatures | None":
        """Features of the map on which all that is movable stands; None if nothing is."""
        return None if self.grid.movable is None else self._furnished

    @cached_property
    def _furnished(self) -> "MapFeatures":
        return replace(self, grid=self.grid.furnished)

    @property
    def both(self) -> "tuple[MapFeatures, ...]":
        """Features of the bare map, and of the furnished one if it names what is movable."""
        return (self,) if self.furnished is None else (self, self.furnished)

    @cached_property
    def thickness(self) -> float:
        """Median thickness of the walls, metres: others draw them thicker than scans show them."""
        return wall_thickness(self.field.distance)

    @cached_property
    def straight(self) -> bool:
        """True if the borders of most walls are so straight that somebody drew them."""
        share = straight_share(self.grid.occupied, round(RUN / self.grid.resolution))
        return bool(share > DRAWN)

    @property
    def peels(self) -> bool:
        """True if :meth:`thinner` walls have images of their own: not on very large maps."""
        return self.grid.occupied.size <= PEELED_CELLS

    def thinner(self, cells: int) -> "MapFeatures":
        """Features of the same map with walls that lose so many cells on each side.

        Lines of one cell stay (:func:`~imgloc.features.distance.peeled`); what was wall is free.
        They are kept as long as these features. A very large map keeps its images: its surfaces
        lie so much deeper in them, and lines of a few cells are gone.
        """
        if cells == 0:
            return self
        if cells not in self._thinner and not self.peels:
            there = replace(self)
            recessed = replace(self.field, recess=cells * self.grid.resolution)
            of = ("straight", "standable", "walls", "free")
            vars(there).update({name: getattr(self, name) for name in of}, field=recessed)
            self._thinner[cells] = there
        elif cells not in self._thinner:
            there = self.thinner(cells - 1)
            walls = peeled(there.grid.occupied)
            if not np.array_equal(walls, there.grid.occupied):  # else they are lines by now
                free = self.grid.free | (self.grid.occupied & ~walls)
                there = replace(self, grid=replace(self.grid, occupied=walls, free=free))
                vars(there)["straight"] = self.straight  # what was drawn stays drawn
            self._thinner[cells] = there
        return self._thinner[cells]

    @cached_property
    def _thinner(self) -> dict[int, "MapFeatures"]:
        return {}

    def ready(self, thinnest: int = 0) -> "MapFeatures":
        """Compute now what the default method may use, and return these features.

        That includes the same map with walls up to `thinnest` cells thinner, but of a small map
        only. On a very large map (see :attr:`peels`) only what each answer uses is computed.
        """
        _ = self.straight  # what needs more than it keeps comes before what keeps much
        for there in self.both:
            _ = there.standable, there.walls, there.field, there.free, there.pyramid
        if self.peels:
            _ = self.thickness
            ahead = thinnest if self.grid.occupied.size <= AHEAD_CELLS else 0
            for cells in range(1, ahead + 1):
                there = self.thinner(cells)
                _ = there.field, there.walls, there.standable, there.pyramid
        return self

    @cached_property
    def standable(self) -> BoolArray:
        """Map cells in which a sensor can be: free, or next to free and not occupied."""
        near = cv2.dilate(self.grid.free.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        return read_only(near & ~self.grid.occupied)

    @cached_property
    def pyramid(self) -> tuple[Level, ...]:
        """Endpoint images at one, two and four times `cell`, finest first; eight on large maps."""
        coarse = self.lattice.height * self.lattice.width / 16
        return pyramid(
            self.field.steps, self.grid.free, self.grid.resolution, cell=self.cell,
            sigma=self.sigma_endpoint, levels=3 if coarse <= COARSE_CELLS else 4, unit=UNIT,
            recess=self.field.recess,
        )  # fmt: skip

    @cached_property
    def surface(self) -> OrientedPoints:
        """Surface points with directed normals, grid frame."""
        return surface_points(self.grid.occupied, self.grid.free, self.grid.resolution)

    @cached_property
    def bmap(self) -> Float32Array:
        """Blurred map of CBML, (H, W) float32 in 0..1."""
        xy, lattice = self.surface.xy, self.lattice
        return read_only(bmap(xy, lattice.shape, lattice.resolution, self.sigma))

    @cached_property
    def vmap(self) -> Float32Array:
        """Blurred vector field of CBML-O, (2, H, W) float32, no vector longer than 1."""
        g, lattice = self.grid, self.lattice
        if self.vmap_from == "contours":
            return read_only(vmap(self.surface, lattice.shape, lattice.resolution, self.sigma))
        field = vmap_of_image(g.occupied, g.free, g.resolution, self.sigma, factor=self.factor)
        return read_only(field)

    @cached_property
    def visibility(self) -> Float32Array:
        """Visibility of GHT-V, (n_psi, M) float32 metres, direction 0 is the normal."""
        frames = visibility_frames(
            self.grid.occupied, self.surface, self.grid.resolution, self.n_psi, self.horizon,
            by=self.visibility_by, distance=self.walls,
        )  # fmt: skip
        return read_only(frames)

    @property
    def ray_distances(self) -> npt.NDArray[np.uint16]:
        """``r_m`` of eq. 2, (n_rays, H, W) uint16 cm; a ConfigError if over `memory_budget`."""
        return self.ray_distances_within(self.memory_budget)

    def ray_distances_within(self, memory_budget: int | None) -> npt.NDArray[np.uint16]:
        """:attr:`ray_distances` within another budget than the map's own."""
        if "_ray_distances" not in vars(self):
            height, width = self.lattice.shape
            check_budget(
                ray_distances_bytes((height, width), self.n_rays),
                memory_budget,
                f"a stack of ray distances, {self.n_rays} directions x {height} x {width} cells,",
                "use fewer directions or coarser cells, or a larger memory budget",
            )
        return self._ray_distances

    @cached_property
    def _ray_distances(self) -> npt.NDArray[np.uint16]:
        distances = ray_distances(
            self.grid.occupied, self.grid.resolution, self.n_rays, self.max_range,
            factor=self.factor, threads=self.threads,
        )  # fmt: skip
        return read_only(distances)

    def bytes_for(self, method: str) -> int:
        """Peak of computing what a method uses of the map, besides the map itself.

        Examples
        --------
        >>> wall = np.eye(100, dtype=bool)
        >>> features = MapFeatures(OccupancyGrid(wall, ~wall, 0.1))
        >>> features.bytes_for("ght-v") // 2**20
        3
        """
        height, width = self.grid.occupied.shape
        points = surface_count(self.grid)
        seeing = points if method == "ght-v" else 0
        need = features_bytes(
            (height, width), points=points, n_psi=self.n_psi, factor=self.factor, seeing=seeing
        )
        gradients = 48 if method == "cbml-o" and self.vmap_from == "image" else 0
        return len(self.both) * (need + gradients * int(height * width))


def read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A view of an array that cannot be written to."""
    array = array.view()
    array.flags.writeable = False
    return array
