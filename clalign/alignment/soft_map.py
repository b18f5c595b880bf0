"""The two ways to evaluate the soft map P of Eq. 15 and 27, Z = PᵀU and its gradient, and which of them is cheaper.

Both compute the same numbers where `normal` is ψᵀ diag(w) ψ (None: the identity, with ψ orthonormal in w), apart from
rounding. They differ in when the vertices of the side are summed over: once, into packed moments, or anew in every
evaluation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

from clalign.alignment.problem_data import ShapeData
from clalign.engine.backend import Backend


@dataclass(frozen=True)
class MomentsSoftMap:
    """P through moments: z_jr = c_j M_r c_jᵀ / s_j.

    Attributes
    ----------
    packed : (k (k + 1) / 2, r) on the backend, see `clalign.engine.reference.Reference`.
    normal : (k, k) on the backend, or None for the identity.
    """

    packed: Any
    normal: Any

    def forward(self, backend: Backend, carried: Any) -> tuple[Any, Any]:
        """Return Z (n, r) and s (n,) for the rows c_j of `carried` (n, k)."""
        return backend.soft_map(carried, self.packed, self.normal)

    def gradient(self, backend: Backend, carried: Any, z: Any, s: Any, dz: Any) -> Any:
        """Return the gradient by `carried` (n, k) from that by Z."""
        return backend.soft_map_gradient(carried, self.packed, self.normal, z, s, dz)


@dataclass(frozen=True)
class StreamedSoftMap:
    """P from tiles of q_ij = ψ_i·c_j: z_jr = Σ_i w_i q_ij² u_ir / s_j.

    Attributes
    ----------
    basis, weights, left : ψ (n_y, k), w (n_y,) and U (n_y, r), on the backend.
    """

    basis: Any
    weights: Any
    left: Any

    def forward(self, backend: Backend, carried: Any) -> tuple[Any, Any]:
        """Return Z (n, r) and s (n,) for the rows c_j of `carried` (n, k)."""
        return backend.soft_map_streamed(carried, self.basis, self.weights, self.left)

    def gradient(self, backend: Backend, carried: Any, z: Any, s: Any, dz: Any) -> Any:
        """Return the gradient by `carried` (n, k) from that by Z."""
        return backend.soft_map_streamed_gradient(carried, self.basis, self.weights, self.left, z, s, dz)


SoftMap: TypeAlias = MomentsSoftMap | StreamedSoftMap


def evaluation_cost(rows: int, vertices: int, functions: int, rank: int) -> tuple[int, int]:
    """Return the multiply-adds of value and gradient of one soft map, through moments and streamed.

    Both run at about the same rate (``clalign bench kernels`` measures them side by side), so that these numbers alone
    decide.

    Parameters
    ----------
    rows : n, samples of the source.
    vertices : n_y, of the target.
    functions, rank : k and r.
    """
    pairs = functions * (functions + 1) // 2
    moments = 2 * rows * pairs * rank
    streamed = rows * vertices * ((functions + rank) + (2 * functions + rank))
    return moments, streamed


def streaming_pays(rows: int, vertices: int, functions: int, rank: int) -> bool:
    """Tell whether the streamed form is the cheaper one; arguments as in `evaluation_cost`."""
    moments, streamed = evaluation_cost(rows, vertices, functions, rank)
    return streamed < moments


def moments_soft_map(backend: Backend, side: ShapeData) -> MomentsSoftMap:
    """Return P towards the vertices of `side`, through moments."""
    array = backend.array
    packed = backend.packed_moments(array(side.basis), array(side.soft_weights), array(side.left))
    return MomentsSoftMap(packed, None if side.normal is None else array(side.normal))


def streamed_soft_map(backend: Backend, side: ShapeData) -> StreamedSoftMap:
    """Return P towards the vertices of `side`, streamed."""
    array = backend.array
    return StreamedSoftMap(array(side.basis), array(side.soft_weights), array(side.left))


def cheaper_soft_map(backend: Backend, side: ShapeData, rows: int) -> SoftMap:
    """Return P towards the vertices of `side` in the form that costs less for `rows` vertices of the other shape."""
    (vertices, functions), rank = side.basis.shape, side.left.shape[1]
    make = streamed_soft_map if streaming_pays(rows, vertices, functions, rank) else moments_soft_map
    return make(backend, side)
