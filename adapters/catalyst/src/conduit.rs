//! Reading and writing Conduit nodes through Catalyst's C functions, found when first needed.
//!
//! The host has Catalyst's library loaded already, so none is needed to build this one. A host that loaded it for itself
//! alone (Python, plugins) hides its names from the others: then the library is asked for by name, without loading another.
//!
//! The C functions throw C++ exceptions through their caller when a path is missing or a value has another type. Here every
//! fetch is preceded by `has_path`, and every access to a value by a look at its type.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::marker::PhantomData;
use std::sync::OnceLock;

use gloaming::{Error, Result};

/// `conduit_node`, which only the host's library can look into.
#[repr(C)]
pub struct RawNode {
    _opaque: [u8; 0],
}

/// `conduit_datatype`, likewise.
#[repr(C)]
struct RawType {
    _opaque: [u8; 0],
}

const OBJECT: i64 = 1;
const STRING: i64 = 13;

/// Declares the functions that are used and finds them under the names that Catalyst gives them.
macro_rules! functions {
    ($($name:ident: fn($($argument:ty),*) $(-> $returned:ty)?;)*) => {
        /// Catalyst's functions on nodes.
        struct Conduit {
            $($name: unsafe extern "C" fn($($argument),*) $(-> $returned)?,)*
        }

        impl Conduit {
            fn find(find: impl Fn(&CStr) -> *mut c_void) -> std::result::Result<Conduit, &'static str> {
                Ok(Conduit {
                    $($name: {
                        const NAME: &str = concat!("catalyst_conduit_", stringify!($name), "\0");
                        let name = CStr::from_bytes_with_nul(NAME.as_bytes()).expect("ends in a nul");
                        let found = find(name);
                        if found.is_null() {
                            return Err(NAME.trim_end_matches('\0'));
                        }
                        // SAFETY: the symbol is the function of that name in Catalyst's public C interface, whose signature
                        // is the one declared below.
                        unsafe { std::mem::transmute::<*mut c_void, unsafe extern "C" fn($($argument),*) $(-> $returned)?>(found) }
                    },)*
                })
            }
        }
    };
}

functions! {
    node_has_path: fn(*const RawNode, *const c_char) -> c_int;
    node_fetch_existing: fn(*mut RawNode, *const c_char) -> *mut RawNode;
    node_child: fn(*mut RawNode, i64) -> *mut RawNode;
    node_number_of_children: fn(*mut RawNode) -> i64;
    node_name: fn(*const RawNode) -> *mut c_char;
    node_dtype: fn(*const RawNode) -> *const RawType;
    node_element_ptr: fn(*mut RawNode, i64) -> *mut c_void;
    node_as_char8_str: fn(*mut RawNode) -> *mut c_char;
    node_set_path_char8_str: fn(*mut RawNode, *const c_char, *const c_char);
    node_set_path_int64: fn(*mut RawNode, *const c_char, i64);
    node_set_path_float64: fn(*mut RawNode, *const c_char, f64);
    datatype_id: fn(*const RawType) -> i64;
    datatype_number_of_elements: fn(*const RawType) -> i64;
    datatype_stride: fn(*const RawType) -> i64;
    datatype_element_bytes: fn(*const RawType) -> i64;
}

/// The functions, once they have been found.
fn conduit() -> Result<&'static Conduit> {
    static FOUND: OnceLock<Conduit> = OnceLock::new();
    if let Some(found) = FOUND.get() {
        return Ok(found);
    }
    let everywhere = |name: &CStr| {
        // SAFETY: looks a name up among the libraries that the process has loaded.
        unsafe { libc::dlsym(libc::RTLD_DEFAULT, name.as_ptr()) }
    };
    let found = Conduit::find(everywhere).or_else(|_| Conduit::find(hidden));
    let found = found.map_err(|missing| {
        Error::Closed(format!(
            "`{missing}` is in no library of this process: gloaming is loaded by Catalyst 2.0 or later"
        ))
    })?;
    Ok(FOUND.get_or_init(|| found))
}

/// A function of a Catalyst library that was loaded without showing its names to others.
fn hidden(name: &CStr) -> *mut c_void {
    let names: [&CStr; 2] = if cfg!(target_os = "macos") {
        [c"@rpath/libcatalyst.3.dylib", c"libcatalyst.3.dylib"]
    } else {
        [c"libcatalyst.so.3", c"libcatalyst.so"]
    };
    for library in names {
        // SAFETY: RTLD_NOLOAD runs no code: it answers with the library where it is loaded already. The handle stays open,
        // so that the functions found in it stay valid.
        let found = unsafe {
            let handle = libc::dlopen(library.as_ptr(), libc::RTLD_LAZY | libc::RTLD_NOLOAD);
            if handle.is_null() { std::ptr::null_mut() } else { libc::dlsym(handle, name.as_ptr()) }
        };
        if !found.is_null() {
            return found;
        }
    }
    std::ptr::null_mut()
}

/// A node of the host, for as long as the host's call lasts.
#[derive(Clone)]
pub struct Node<'host> {
    raw: *mut RawNode,
    /// Where it is, for messages.
    pub path: String,
    conduit: &'static Conduit,
    lifetime: PhantomData<&'host RawNode>,
}

/// A number type of Conduit's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Number {
    /// Signed integers by their bytes.
    Int(usize),
    /// Unsigned integers by their bytes.
    Uint(usize),
    /// Floats by their bytes.
    Float(usize),
}

impl Number {
    fn of(id: i64) -> Option<Number> {
        Some(match id {
            3..=6 => Number::Int(1 << (id - 3)),
            7..=10 => Number::Uint(1 << (id - 7)),
            11 => Number::Float(4),
            12 => Number::Float(8),
            _ => return None,
        })
    }

    /// Bytes of one value.
    pub fn bytes(self) -> usize {
        match self {
            Number::Int(bytes) | Number::Uint(bytes) | Number::Float(bytes) => bytes,
        }
    }
}

/// The host's array: `count` numbers, `stride` bytes apart.
#[derive(Debug, Clone, Copy)]
pub struct Array<'host> {
    /// The first number, which need not be aligned.
    first: *const u8,
    /// What the numbers are.
    pub number: Number,
    /// How many.
    pub count: usize,
    /// Bytes from one to the next.
    pub stride: isize,
    lifetime: PhantomData<&'host u8>,
}

impl<'host> Node<'host> {
    /// The root of a tree that the host handed over.
    ///
    /// # Safety
    /// `raw` is null or a Conduit node of the host's that lives, and that nobody else writes to, for `'host`.
    pub unsafe fn root(raw: *const RawNode) -> Result<Node<'host>> {
        if raw.is_null() {
            return Err(Error::format("catalyst", "the simulation passed no node", ""));
        }
        Ok(Node { raw: raw.cast_mut(), path: String::new(), conduit: conduit()?, lifetime: PhantomData })
    }

    fn at(&self, raw: *mut RawNode, name: &str) -> Node<'host> {
        let path = if self.path.is_empty() { name.into() } else { format!("{}/{name}", self.path) };
        Node { raw, path, ..self.clone() }
    }

    /// The node at a path below this one, if there is one.
    pub fn get(&self, path: &str) -> Option<Node<'host>> {
        if self.kind() != OBJECT {
            return None;
        }
        let name = CString::new(path).ok()?;
        // SAFETY: the node is live; `fetch_existing` throws only when `has_path` says no.
        let found = unsafe {
            if (self.conduit.node_has_path)(self.raw, name.as_ptr()) == 0 {
                return None;
            }
            (self.conduit.node_fetch_existing)(self.raw, name.as_ptr())
        };
        (!found.is_null()).then(|| self.at(found, path))
    }

    /// The node at a path below this one.
    ///
    /// # Errors
    /// [`Error::Format`] that names the missing path.
    pub fn need(&self, path: &str) -> Result<Node<'host>> {
        self.get(path).ok_or_else(|| {
            Error::format(self.at(self.raw, path).path, "missing", "what Catalyst's mesh blueprint asks for")
        })
    }

    /// The children of an object or list; none where it is neither.
    pub fn children(&self) -> Vec<(String, Node<'host>)> {
        if !matches!(self.kind(), OBJECT | 2) {
            return vec![];
        }
        // SAFETY: the node is live, and indices stay below the number of children.
        let count = unsafe { (self.conduit.node_number_of_children)(self.raw) };
        let child = |index: i64| {
            // SAFETY: as above.
            let raw = unsafe { (self.conduit.node_child)(self.raw, index) };
            if raw.is_null() {
                return None;
            }
            let name = self.name_of(raw).unwrap_or_else(|| index.to_string());
            Some((name.clone(), self.at(raw, &name)))
        };
        (0..count).filter_map(child).collect()
    }

    /// The name of a node; an entry of a list has none.
    fn name_of(&self, raw: *mut RawNode) -> Option<String> {
        // SAFETY: the node is live; the text is a copy that Conduit made with malloc for us to free.
        unsafe {
            let text = (self.conduit.node_name)(raw);
            if text.is_null() {
                return None;
            }
            let name = CStr::from_ptr(text).to_string_lossy().into_owned();
            libc::free(text.cast());
            (!name.is_empty()).then_some(name)
        }
    }

    fn dtype(&self) -> *const RawType {
        // SAFETY: the node is live.
        unsafe { (self.conduit.node_dtype)(self.raw) }
    }

    /// Conduit's number for the type of the node; 0 is empty.
    fn kind(&self) -> i64 {
        let dtype = self.dtype();
        // SAFETY: the type belongs to the live node.
        if dtype.is_null() { 0 } else { unsafe { (self.conduit.datatype_id)(dtype) } }
    }

    /// True when nothing but children is here.
    pub fn is_object(&self) -> bool {
        self.kind() == OBJECT
    }

    /// The text of a string.
    pub fn text(&self) -> Option<String> {
        if self.kind() != STRING {
            return None;
        }
        // SAFETY: the node is live and a string, which Conduit ends in a nul.
        unsafe {
            let text = (self.conduit.node_as_char8_str)(self.raw);
            (!text.is_null()).then(|| CStr::from_ptr(text).to_string_lossy().into_owned())
        }
    }

    /// The text of a string that has to be there.
    pub fn need_text(&self, path: &str) -> Result<String> {
        let node = self.need(path)?;
        node.text().ok_or_else(|| Error::format(node.path.clone(), format!("{}, not a string", node.kind_name()), ""))
    }

    /// The numbers at this node.
    ///
    /// # Errors
    /// [`Error::Format`] when they are no numbers.
    pub fn array(&self) -> Result<Array<'host>> {
        let number = Number::of(self.kind())
            .ok_or_else(|| Error::format(self.path.clone(), format!("{}, not numbers", self.kind_name()), ""))?;
        let dtype = self.dtype();
        // SAFETY: the type belongs to the live node.
        let (count, stride, bytes) = unsafe {
            (
                (self.conduit.datatype_number_of_elements)(dtype),
                (self.conduit.datatype_stride)(dtype),
                (self.conduit.datatype_element_bytes)(dtype),
            )
        };
        let count = usize::try_from(count).unwrap_or(0);
        if bytes != number.bytes() as i64 {
            let found = format!("{} of {bytes} bytes each, which is no size of theirs", self.kind_name());
            return Err(Error::format(self.path.clone(), found, ""));
        }
        let first = match count {
            0 => std::ptr::null_mut(),
            // SAFETY: element 0 exists; its place includes the offset.
            _ => unsafe { (self.conduit.node_element_ptr)(self.raw, 0) },
        };
        if first.is_null() {
            return Err(Error::format(self.path.clone(), "no values", ""));
        }
        Ok(Array { first: first.cast(), number, count, stride: stride as isize, lifetime: PhantomData })
    }

    /// The first number at this node, of whatever type.
    pub fn number(&self) -> Result<f64> {
        Ok(self.array()?.get(0))
    }

    /// The first number at this node as a whole one.
    pub fn integer(&self) -> Result<i64> {
        let value = self.number()?;
        if value.fract() != 0.0 || value.abs() > 9e15 {
            return Err(Error::format(self.path.clone(), format!("{value}, not a whole number"), ""));
        }
        Ok(value as i64)
    }

    fn kind_name(&self) -> &'static str {
        match self.kind() {
            0 => "empty",
            OBJECT => "an object",
            2 => "a list",
            3..=6 => "signed integers",
            7..=10 => "unsigned integers",
            11 | 12 => "floats",
            STRING => "a string",
            _ => "of an unknown type",
        }
    }

    /// Writes a text below this node.
    pub fn put_text(&self, path: &str, text: &str) {
        if let (Ok(path), Ok(text)) = (CString::new(path), CString::new(text.replace('\0', " "))) {
            // SAFETY: the node is live and ours to fill; Conduit copies the text.
            unsafe { (self.conduit.node_set_path_char8_str)(self.raw, path.as_ptr(), text.as_ptr()) }
        }
    }

    /// Writes a whole number below this node.
    pub fn put_integer(&self, path: &str, value: u64) {
        if let Ok(path) = CString::new(path) {
            let value = i64::try_from(value).unwrap_or(i64::MAX);
            // SAFETY: the node is live and ours to fill.
            unsafe { (self.conduit.node_set_path_int64)(self.raw, path.as_ptr(), value) }
        }
    }

    /// Writes a number below this node.
    pub fn put_number(&self, path: &str, value: f64) {
        if let Ok(path) = CString::new(path) {
            // SAFETY: the node is live and ours to fill.
            unsafe { (self.conduit.node_set_path_float64)(self.raw, path.as_ptr(), value) }
        }
    }
}

impl<'host> Array<'host> {
    /// The bytes from the lowest to the highest, and where among them the first number begins.
    pub fn bytes(&self) -> (&'host [u8], usize) {
        let reach = self.stride.saturating_mul(self.count.saturating_sub(1) as isize);
        let before = reach.min(0).unsigned_abs();
        let length = reach.unsigned_abs() + self.number.bytes();
        // SAFETY: the host vouches for `count` numbers `stride` bytes apart, hence for what lies between the outermost, and leaves
        // them alone during its call.
        (unsafe { std::slice::from_raw_parts(self.first.wrapping_sub(before), length) }, before)
    }

    /// Number `index`.
    pub fn get(&self, index: usize) -> f64 {
        debug_assert!(index < self.count);
        // SAFETY: the host vouches for `count` numbers `stride` bytes apart; none need be aligned.
        unsafe {
            let at = self.first.offset(self.stride * index as isize);
            match self.number {
                Number::Int(1) => f64::from(at.cast::<i8>().read_unaligned()),
                Number::Int(2) => f64::from(at.cast::<i16>().read_unaligned()),
                Number::Int(4) => f64::from(at.cast::<i32>().read_unaligned()),
                Number::Int(_) => at.cast::<i64>().read_unaligned() as f64,
                Number::Uint(1) => f64::from(at.read_unaligned()),
                Number::Uint(2) => f64::from(at.cast::<u16>().read_unaligned()),
                Number::Uint(4) => f64::from(at.cast::<u32>().read_unaligned()),
                Number::Uint(_) => at.cast::<u64>().read_unaligned() as f64,
                Number::Float(4) => f64::from(at.cast::<f32>().read_unaligned()),
                Number::Float(_) => at.cast::<f64>().read_unaligned(),
            }
        }
    }
}
