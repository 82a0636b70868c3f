"""Writes one volume behind every filter that h5py and hdf5plugin have: write_filters.py OUT NX NY NZ v108|v110.

The values are value(x, y, z) = x² + 31·y + 977·z in the dataset's own type, smooth enough to pack and told again by the test.
"""
import sys

import h5py
import hdf5plugin as hp
import numpy as np

out, (nx, ny, nz) = sys.argv[1], map(int, sys.argv[2:5])
z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
values = x * x + 31 * y + 977 * z
chunks = (max(nz // 2 - 1, 1), ny // 2 + 3, nx // 3 + 1)

filters = {
    "plain": {},
    "gzip": {"compression": "gzip"},
    "gzip_shuffle_fletcher": {"compression": "gzip", "shuffle": True, "fletcher32": True},
    "fletcher": {"fletcher32": True},
    "lzf": {"compression": "lzf"},
    "lzf_shuffle": {"compression": "lzf", "shuffle": True},
    "scaleoffset": {"scaleoffset": 0},
    "zstd": hp.Zstd(clevel=3),
    "zstd_shuffle": {**hp.Zstd(), "shuffle": True},
    "lz4": hp.LZ4(),
    "lz4_blocks": hp.LZ4(nbytes=1024),
    "bitshuffle": hp.Bitshuffle(cname="none"),
    "bitshuffle_lz4": hp.Bitshuffle(cname="lz4"),
    "bitshuffle_zstd": hp.Bitshuffle(cname="zstd"),
}
for name in ["blosclz", "lz4", "lz4hc", "zlib", "zstd"]:
    for how, code in [("none", hp.Blosc.NOSHUFFLE), ("bytes", hp.Blosc.SHUFFLE), ("bits", hp.Blosc.BITSHUFFLE)]:
        filters[f"blosc_{name}_{how}"] = hp.Blosc(cname=name, clevel=5, shuffle=code)
        filters[f"blosc2_{name}_{how}"] = hp.Blosc2(cname=name, clevel=5, filters=code)

with h5py.File(out, "w", libver=(sys.argv[5], sys.argv[5])) as file:
    for name, options in filters.items():
        kinds = ["<i2", "<i4"] if "scaleoffset" in name else ["<f4", ">f8", "<i2"]
        for kind in kinds[:1] if "blosc" in name else kinds:
            file.create_dataset(f"{name}_{kind[1:]}", data=values.astype(kind), chunks=chunks, **options)
    # Chunks that Blosc2 keeps as a word, and chunks that were never written.
    file.create_dataset("zeros", data=np.zeros_like(values, "<f4"), chunks=chunks, **hp.Blosc2())
    file.create_dataset("nan", data=np.full_like(values, np.nan, "<f4"), chunks=chunks, **hp.Blosc2())
    file.create_dataset("absent", shape=values.shape, dtype="<f4", chunks=chunks, fillvalue=7, compression="gzip")
    # A chunk that the filters were not applied to.
    odd = file.create_dataset("masked", shape=values.shape, dtype="<f4", chunks=values.shape, compression="gzip")
    odd.id.write_direct_chunk((0, 0, 0), values.astype("<f4").tobytes(), filter_mask=1)
    file.create_dataset("zfp", data=values.astype("<f4"), chunks=chunks, **hp.Zfp(reversible=True))
