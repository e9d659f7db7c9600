//! Writer of Python pickles of protocol 2: dictionaries, lists and texts.
//!
//! The format is a program for a stack machine: a container is created empty, its items are pushed after a
//! mark, and one operation adds them all. Operations: `pickletools` of Python's standard library.

use std::io::{Error, ErrorKind, Result, Write};

/// Operations `PROTO 2` and `EMPTY_DICT`: begin of a pickle that is a dictionary.
pub(super) const BEGIN: &[u8] = b"\x80\x02}";
const STOP: &[u8] = b".";
const EMPTY_DICT_MARK: &[u8] = b"}(";
const SETITEMS: &[u8] = b"u";
const EMPTY_LIST_MARK: &[u8] = b"](";
const APPENDS: &[u8] = b"e";
const BINUNICODE: &[u8] = b"X";
const PROTOCOL: &[u8] = b"\x80\x02";

/// Writes a whole pickle, whose one value `value` writes.
pub(super) fn whole<W: Write>(out: &mut W, value: impl FnOnce(&mut W) -> Result<()>) -> Result<()> {
    out.write_all(PROTOCOL)?;
    value(out)?;
    out.write_all(STOP)
}

/// Writes a dictionary with texts as keys; `value` writes each value.
pub(super) fn dict<W: Write, K: AsRef<str>, V>(
    out: &mut W,
    items: impl IntoIterator<Item = (K, V)>,
    mut value: impl FnMut(&mut W, V) -> Result<()>,
) -> Result<()> {
    out.write_all(EMPTY_DICT_MARK)?;
    for (key, item) in items {
        text(out, key.as_ref())?;
        value(out, item)?;
    }
    out.write_all(SETITEMS)
}

/// Writes a list; `value` writes each item.
pub(super) fn list<W: Write, V>(
    out: &mut W,
    items: impl IntoIterator<Item = V>,
    mut value: impl FnMut(&mut W, V) -> Result<()>,
) -> Result<()> {
    out.write_all(EMPTY_LIST_MARK)?;
    items.into_iter().try_for_each(|item| value(out, item))?;
    out.write_all(APPENDS)
}

/// Writes a text.
pub(super) fn text(out: &mut impl Write, text: &str) -> Result<()> {
    let length = u32::try_from(text.len()).map_err(|error| Error::new(ErrorKind::InvalidInput, error))?;
    out.write_all(BINUNICODE)?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes of `pickletools.optimize(pickle.dumps({"a": ["é", "b"], "c": []}, 2))` in Python, and the
    /// mark and end of an empty list.
    #[test]
    fn values_have_their_operations() {
        let mut bytes = Vec::new();
        let items = [("a", vec!["é", "b"]), ("c", vec![])];
        whole(&mut bytes, |out| dict(out, items, |out, texts| list(out, texts, text))).unwrap();
        let expected =
            b"\x80\x02}(X\x01\0\0\0a](X\x02\0\0\0\xc3\xa9X\x01\0\0\0beX\x01\0\0\0c](eu.".as_slice();
        assert_eq!(bytes, expected);
        assert!(bytes.starts_with(BEGIN));
    }
}
