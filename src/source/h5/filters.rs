//! The filters of HDF5 chunks, undone here: outside of the lock that HDF5 holds while it decodes, so on all cores.
//!
//! A chunk is stored as `fₙ(… f₂(f₁(values)))`; each filter has an id in the HDF Group's list of registered filters. A
//! decoder writes into a buffer of the length that the pipeline must yield: no length that a chunk claims is believed.

mod bitshuffle;
mod blosc;
mod blosc2;
mod blosclz;
mod checksum;
mod lz4;
mod lzf;
mod shuffle;

use hdf5::Dataset;
use hdf5::filters::Filter;

/// One filter.
#[derive(Debug, Clone, PartialEq)]
enum Stage {
    Deflate,
    /// Bytes of an element.
    Shuffle(usize),
    Fletcher32,
    Lzf,
    Blosc,
    Lz4,
    Bitshuffle(bitshuffle::Options),
    Zstd,
    Blosc2,
}

/// The filters of a dataset, in the order in which they were applied.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pipeline(Vec<Stage>);

/// Names in the HDF Group's list of registered filters, for messages.
const REGISTERED: [(i32, &str); 33] = [
    (4, "szip"),
    (5, "n-bit"),
    (6, "scale-offset"),
    (305, "LZO"),
    (307, "bzip2"),
    (32000, "LZF"),
    (32001, "Blosc"),
    (32002, "MAFISC"),
    (32003, "Snappy"),
    (32004, "LZ4"),
    (32005, "APAX"),
    (32006, "CBF"),
    (32007, "JPEG-XR"),
    (32008, "Bitshuffle"),
    (32009, "SPDP"),
    (32010, "LPC-Rice"),
    (32011, "CCSDS-123"),
    (32012, "JPEG-LS"),
    (32013, "ZFP"),
    (32014, "FPZip"),
    (32015, "Zstandard"),
    (32016, "B³D"),
    (32017, "SZ"),
    (32018, "FCIDECOMP"),
    (32019, "JPEG"),
    (32020, "VBZ"),
    (32021, "FAPEC"),
    (32022, "BitGroom"),
    (32023, "Granular BitRound"),
    (32024, "SZ3"),
    (32025, "Delta-Rice"),
    (32026, "Blosc2"),
    (32027, "FLAC"),
];

/// The name of a registered filter; empty for others.
pub(crate) fn name_of(id: i32) -> &'static str {
    REGISTERED.iter().find(|(known, _)| *known == id).map_or("", |(_, name)| name)
}

impl Pipeline {
    /// True when chunks are stored as they are.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The filters of a dataset whose elements have `element` bytes; `None` when HDF5 has to decode it: there are
    /// filters that only HDF5 or a plugin of its knows.
    pub fn of(dataset: &Dataset, element: usize) -> Option<Pipeline> {
        let filters = dataset.dcpl().ok()?.get_filters().ok()?;
        let stages: Vec<Stage> = filters.iter().map(|f| Stage::of(f, element)).collect::<Option<_>>()?;
        // Where one packed what another had packed, the lengths between them are not known.
        let packing = stages.iter().filter(|s| s.packs()).count();
        (packing <= 1).then_some(Pipeline(stages))
    }

    /// Undoes the filters that `mask` does not except (bit i: filter i was not applied). `bytes` become the `length`
    /// bytes that were stored; `spare` is scratch. The error says which filter found what.
    pub fn undo(&self, mask: u32, length: usize, bytes: &mut Vec<u8>, spare: &mut Vec<u8>) -> Result<(), String> {
        let applied = |i: usize| i >= 32 || mask & (1 << i) == 0;
        for (i, stage) in self.0.iter().enumerate().rev().filter(|(i, _)| applied(*i)) {
            let checksums = (0..i).filter(|&j| applied(j) && self.0[j] == Stage::Fletcher32).count();
            stage.undo(length + 4 * checksums, bytes, spare).map_err(|why| format!("{}: {why}", stage.name()))?;
        }
        if bytes.len() != length {
            return Err(format!("it has {} bytes instead of {length}", bytes.len()));
        }
        Ok(())
    }
}

impl Stage {
    fn of(filter: &Filter, element: usize) -> Option<Stage> {
        Some(match filter {
            Filter::Deflate(_) => Stage::Deflate,
            Filter::Shuffle => Stage::Shuffle(element),
            Filter::Fletcher32 => Stage::Fletcher32,
            Filter::User(32000, _) => Stage::Lzf,
            Filter::User(32001, _) => Stage::Blosc,
            Filter::User(32004, _) => Stage::Lz4,
            Filter::User(32008, values) => Stage::Bitshuffle(bitshuffle::Options::of(values, element)?),
            Filter::User(32015, _) => Stage::Zstd,
            Filter::User(32026, _) => Stage::Blosc2,
            _ => return None,
        })
    }

    /// Whether the length of the output is not that of the input.
    fn packs(&self) -> bool {
        !matches!(self, Stage::Shuffle(_) | Stage::Fletcher32)
    }

    fn name(&self) -> &'static str {
        match self {
            Stage::Deflate => "deflate",
            Stage::Shuffle(_) => "shuffle",
            Stage::Fletcher32 => "Fletcher-32",
            Stage::Lzf => "LZF",
            Stage::Blosc => "Blosc",
            Stage::Lz4 => "LZ4",
            Stage::Bitshuffle(_) => "Bitshuffle",
            Stage::Zstd => "Zstandard",
            Stage::Blosc2 => "Blosc2",
        }
    }

    /// Turns `bytes` into the `length` bytes that went in.
    fn undo(&self, length: usize, bytes: &mut Vec<u8>, spare: &mut Vec<u8>) -> Result<(), String> {
        if *self == Stage::Fletcher32 {
            return checksum::strip(bytes);
        }
        spare.resize(length, 0);
        match self {
            Stage::Deflate => deflate(bytes, spare)?,
            Stage::Shuffle(element) => shuffle::undo(*element, same(bytes, length)?, spare),
            Stage::Lzf => lzf::decode(bytes, spare)?,
            Stage::Blosc => blosc::decode(bytes, spare)?,
            Stage::Lz4 => lz4::decode(bytes, spare)?,
            Stage::Bitshuffle(options) => options.decode(bytes, spare)?,
            Stage::Zstd => zstd(bytes, spare)?,
            Stage::Blosc2 => blosc2::decode(bytes, spare)?,
            Stage::Fletcher32 => {}
        }
        std::mem::swap(bytes, spare);
        Ok(())
    }
}

fn same(bytes: &[u8], length: usize) -> Result<&[u8], String> {
    if bytes.len() == length { Ok(bytes) } else { Err(format!("{} bytes instead of {length}", bytes.len())) }
}

/// What a decoder says whose output is not as long as it must be.
fn filled(written: usize, out: &[u8]) -> Result<(), String> {
    if written == out.len() { Ok(()) } else { Err(format!("{written} bytes instead of {}", out.len())) }
}

/// The next `count` bytes of what is left.
fn take<'a>(from: &mut &'a [u8], count: usize) -> Result<&'a [u8], String> {
    let (taken, left) = from.split_at_checked(count).ok_or("it ends early")?;
    *from = left;
    Ok(taken)
}

/// The next `N` bytes of what is left.
fn word<const N: usize>(from: &mut &[u8]) -> Result<[u8; N], String> {
    let (taken, left) = from.split_first_chunk().ok_or("it ends early")?;
    *from = left;
    Ok(*taken)
}

fn deflate(bytes: &[u8], out: &mut [u8]) -> Result<(), String> {
    thread_local! {
        static DECODER: std::cell::RefCell<libdeflater::Decompressor> = libdeflater::Decompressor::new().into();
    }
    let written = DECODER.with_borrow_mut(|d| d.zlib_decompress(bytes, out)).map_err(|e| e.to_string())?;
    filled(written, out)
}

fn zstd(bytes: &[u8], out: &mut [u8]) -> Result<(), String> {
    let mut decoder = ruzstd::decoding::FrameDecoder::new();
    let written = decoder.decode_all(bytes, out).map_err(|e| e.to_string())?;
    filled(written, out)
}

/// Runs the decoders on bytes from anywhere, for the fuzz targets.
pub(crate) fn probe(which: u8, length: usize, bytes: &[u8]) {
    let bits = bitshuffle::Options { element: usize::from(which / 16).max(1), block: 0, coding: which / 8 % 4 };
    let stages = [
        Stage::Deflate,
        Stage::Lzf,
        Stage::Blosc,
        Stage::Lz4,
        Stage::Bitshuffle(bits),
        Stage::Zstd,
        Stage::Blosc2,
        Stage::Shuffle(usize::from(which / 8).max(1)),
    ];
    let pipeline = Pipeline(vec![stages[usize::from(which) % stages.len()].clone()]);
    let _ = pipeline.undo(0, length, &mut bytes.to_vec(), &mut Vec::new());
}
