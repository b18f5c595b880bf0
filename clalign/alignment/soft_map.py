"""The two ways to evaluate the soft map P of Eq. 27, Z = PᵀU and its gradient, and which of them is cheaper.

Both compute the same numbers where `normal` is ψᵀ diag(w) ψ (None: the identity, with ψ orthonormal in w), apart from
rounding: the quadratic form sums over all vertices of the side beforehand, into packed moments, the streamed form in
every evaluation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

from clalign.alignment.problem_data import AlignedSide
from clalign.engine.backend import Backend


@dataclass(frozen=True)
class QuadraticForm:
    """P through moments: z_jr = c_j M_r c_jᵀ / s_j.

    Attributes
    ----------
    packed : (k (k + 1) / 2, r) on the backend, see `backend.SoftMaps`.
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
class StreamedForm:
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


SoftForm: TypeAlias = QuadraticForm | StreamedForm


def evaluation_cost(rows: int, vertices: int, functions: int, rank: int) -> tuple[int, int]:
    """Return the multiply-adds of value and gradient of one soft map, by the quadratic and by the streamed form.

    Both run at about the same rate (``clalign bench kernels`` measures them side by side), so that these numbers alone
    decide.

    Parameters
    ----------
    rows : n, samples of the source.
    vertices : n_y, of the target.
    functions, rank : k and r.
    """
    pairs = functions * (functions + 1) // 2
    quadratic = 2 * rows * pairs * rank
    streamed = rows * vertices * ((functions + rank) + (2 * functions + rank))
    return quadratic, streamed


def streaming_pays(rows: int, vertices: int, functions: int, rank: int) -> bool:
    """Tell whether the streamed form is the cheaper one; arguments as in `evaluation_cost`."""
    quadratic, streamed = evaluation_cost(rows, vertices, functions, rank)
    return streamed < quadratic


def quadratic_form(backend: Backend, side: AlignedSide) -> QuadraticForm:
    """Return P towards the vertices of `side`, as a quadratic form."""
    array = backend.array
    packed = backend.packed_moments(array(side.basis), array(side.soft_weights), array(side.left))
    return QuadraticForm(packed, None if side.normal is None else array(side.normal))


def streamed_form(backend: Backend, side: AlignedSide) -> StreamedForm:
    """Return P towards the vertices of `side`, streamed."""
    array = backend.array
    return StreamedForm(array(side.basis), array(side.soft_weights), array(side.left))


def cheaper_form(backend: Backend, side: AlignedSide, rows: int) -> SoftForm:
    """Return P towards the vertices of `side` in the form that costs less for `rows` vertices of the other shape."""
    (vertices, functions), rank = side.basis.shape, side.left.shape[1]
    make = streamed_form if streaming_pays(rows, vertices, functions, rank) else quadratic_form
    return make(backend, side)
