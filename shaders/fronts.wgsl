// Direct light over the bricks of one front, of which none depends on another.

// `count` numbers in `bricks` from `first` on. For the cubic kernel `first` is the layer.
struct Dispatch {
    first: u32,
    count: u32,
}

@group(0) @binding(1) var<storage, read> sigma: array<f32>;
@group(0) @binding(2) var<storage, read_write> rho: array<f32>;
@group(0) @binding(3) var<storage, read> bricks: array<u32>;
// Largest |new − old| per brick, as the bits of a non-negative f32.
@group(0) @binding(4) var<storage, read_write> changes: array<atomic<u32>>;
var<immediate> front: Dispatch;
