//! Types of stored numbers.

/// Type of a stored number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Kind {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F16,
    F32,
    F64,
}

/// Type and byte order of a stored number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dtype {
    /// What the number is.
    pub kind: Kind,
    /// Its byte order.
    pub big_endian: bool,
}

impl Dtype {
    /// A number as this machine's programs hold it in memory.
    pub fn native(kind: Kind) -> Dtype {
        Dtype { kind, big_endian: cfg!(target_endian = "big") }
    }

    /// Reads `f64le`, `u8`, `i16be`, `float32`, `f4`-like names are not taken: sizes are in bits.
    pub fn parse(text: &str) -> Option<Dtype> {
        let lower = text.to_ascii_lowercase();
        let (name, big_endian) = match (lower.strip_suffix("be"), lower.strip_suffix("le")) {
            (Some(name), _) => (name, true),
            (_, Some(name)) => (name, false),
            _ => (lower.as_str(), false),
        };
        let kind = match name {
            "u8" | "uint8" => Kind::U8,
            "i8" | "int8" => Kind::I8,
            "u16" | "uint16" => Kind::U16,
            "i16" | "int16" => Kind::I16,
            "u32" | "uint32" => Kind::U32,
            "i32" | "int32" => Kind::I32,
            "u64" | "uint64" => Kind::U64,
            "i64" | "int64" => Kind::I64,
            "f16" | "float16" | "half" => Kind::F16,
            "f32" | "float32" | "float" => Kind::F32,
            "f64" | "float64" | "double" => Kind::F64,
            _ => return None,
        };
        Some(Dtype { kind, big_endian })
    }

    /// Bytes of one number.
    pub fn bytes(self) -> usize {
        match self.kind {
            Kind::U8 | Kind::I8 => 1,
            Kind::U16 | Kind::I16 | Kind::F16 => 2,
            Kind::U32 | Kind::I32 | Kind::F32 => 4,
            Kind::U64 | Kind::I64 | Kind::F64 => 8,
        }
    }

    /// `f64le`.
    pub fn name(self) -> String {
        let kind = format!("{:?}", self.kind).to_lowercase();
        match (self.bytes(), self.big_endian) {
            (1, _) => kind,
            (_, true) => kind + "be",
            (_, false) => kind + "le",
        }
    }

    /// Decodes numbers that lie `step` bytes apart, the first at byte `first`. Panics where they reach beyond `bytes`.
    pub fn decode<T>(self, bytes: &[u8], first: usize, step: isize, out: &mut [T], narrow: impl Fn(f64) -> T) {
        macro_rules! each {
            ($t:ty, $wide:expr) => {{
                const N: usize = size_of::<$t>();
                let number = |bytes: [u8; N]| {
                    narrow($wide(if self.big_endian { <$t>::from_be_bytes(bytes) } else { <$t>::from_le_bytes(bytes) }))
                };
                if step == N as isize {
                    // Without index arithmetic this is vectorised.
                    let (numbers, _) = bytes[first..first + out.len() * N].as_chunks();
                    out.iter_mut().zip(numbers).for_each(|(o, bytes)| *o = number(*bytes));
                } else {
                    for (o, i) in out.iter_mut().zip(0..) {
                        let at = first.wrapping_add_signed(i * step);
                        let mut one = [0; N];
                        one.copy_from_slice(&bytes[at..at + N]);
                        *o = number(one);
                    }
                }
            }};
        }
        match self.kind {
            Kind::U8 => each!(u8, f64::from),
            Kind::I8 => each!(i8, f64::from),
            Kind::U16 => each!(u16, f64::from),
            Kind::I16 => each!(i16, f64::from),
            Kind::U32 => each!(u32, f64::from),
            Kind::I32 => each!(i32, f64::from),
            Kind::U64 => each!(u64, |v| v as f64),
            Kind::I64 => each!(i64, |v| v as f64),
            Kind::F16 => each!(half::f16, f64::from),
            Kind::F32 => each!(f32, f64::from),
            Kind::F64 => each!(f64, |v| v),
        }
    }
}
