"""The soft correspondence on the device: quadratic form, streamed form, gradients."""

from __future__ import annotations

from clalign.engine.kernels_arrays import operation, require_shapes
from clalign.engine.kernels_products import KernelProducts
from clalign.engine.launching import Array, ArrayPair
from clalign.engine.reference import pair_count


class KernelSoftMaps(KernelProducts):
    """The soft correspondence and its gradients."""

    @operation
    def packed_moments(self, psi: Array, w: Array, u: Array, *, out: Array | None = None) -> Array:
        (n, k), r = psi.shape, u.shape[1]
        require_shapes("packed_moments", w=(w.shape, (n,)), u=(u.shape[:1], (n,)))
        result = self._result("packed_moments", (pair_count(k), r), out)
        self._launcher.packed_moments(psi, w, u, result)
        return result

    @operation
    def packed_moments_gradient(self, psi: Array, w: Array, dpacked: Array, *, out: Array | None = None) -> Array:
        (n, k), r = psi.shape, dpacked.shape[1]
        require_shapes("packed_moments_gradient", w=(w.shape, (n,)), dpacked=(dpacked.shape[:1], (pair_count(k),)))
        result = self._result("packed_moments_gradient", (n, r), out)
        self._launcher.packed_moments_gradient(psi, w, dpacked, result)
        return result

    @operation
    def soft_map(
        self, c: Array, packed: Array, normal: Array | None = None, *, out: ArrayPair | None = None
    ) -> ArrayPair:
        (n, k), r = c.shape, packed.shape[1]
        require_shapes("soft_map", packed=(packed.shape[:1], (pair_count(k),)))
        z = self._result("soft_map", (n, r), out and out[0])
        s = self._result("soft_map", (n,), out and out[1])
        _require_normal(normal, k)
        self._launcher.soft_map(c, packed, normal, z, s)
        return z, s

    @operation
    def soft_map_gradient(
        self, c: Array, packed: Array, normal: Array | None, z: Array, s: Array, dz: Array, *, out: Array | None = None
    ) -> Array:
        (n, k), r = c.shape, packed.shape[1]
        require_shapes("soft_map_gradient", packed=(packed.shape[:1], (pair_count(k),)), z=(z.shape, (n, r)))
        require_shapes("soft_map_gradient", dz=(dz.shape, (n, r)), s=(s.shape, (n,)))
        result = self._result("soft_map_gradient", (n, k), out)
        _require_normal(normal, k)
        self._launcher.soft_map_gradient(c, packed, normal, z, s, dz, result)
        return result

    @operation
    def soft_map_streamed(self, c: Array, psi: Array, w: Array, u: Array, *, out: ArrayPair | None = None) -> ArrayPair:
        (n, k), (n_y, r) = c.shape, u.shape
        require_shapes("soft_map_streamed", psi=(psi.shape, (n_y, k)), w=(w.shape, (n_y,)))
        z = self._result("soft_map_streamed", (n, r), out and out[0])
        s = self._result("soft_map_streamed", (n,), out and out[1])
        self._launcher.soft_map_streamed(c, psi, w, u, z, s)
        return z, s

    @operation
    def soft_map_streamed_gradient(
        self, c: Array, psi: Array, w: Array, u: Array, z: Array, s: Array, dz: Array, *, out: Array | None = None
    ) -> Array:
        (n, k), (n_y, r) = c.shape, u.shape
        require_shapes("soft_map_streamed_gradient", psi=(psi.shape, (n_y, k)), w=(w.shape, (n_y,)))
        require_shapes("soft_map_streamed_gradient", z=(z.shape, (n, r)), dz=(dz.shape, (n, r)), s=(s.shape, (n,)))
        result = self._result("soft_map_streamed_gradient", (n, k), out)
        self._launcher.soft_map_streamed_gradient(c, psi, w, u, z, s, dz, result)
        return result


def _require_normal(normal: Array | None, k: int) -> None:
    if normal is not None:
        require_shapes("soft_map", normal=(normal.shape, (k, k)))
