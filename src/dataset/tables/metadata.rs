//! Metadata of a schema whose values are bytes.
//!
//! Flatbuffers demand UTF-8 of texts, but pyarrow writes any bytes as metadata, and the verifier rejects such
//! a file. So the values are taken out of the footer before it is verified. Layout of tables and vectors:
//! <https://flatbuffers.dev/internals/>.

/// Slot of the schema in a footer.
const SCHEMA: usize = 1;
/// Slot of the metadata in a schema.
const CUSTOM_METADATA: usize = 2;
/// Slots of an entry.
const KEY: usize = 0;
const VALUE: usize = 1;

/// Takes the metadata of the schema out of a footer: returns keys and values, and overwrites the values by
/// spaces. An invalid footer has none.
///
/// # Errors
/// Returns a description of entries that share bytes, of which there could be any number.
pub(super) fn take(footer: &mut [u8]) -> Result<Vec<(String, Vec<u8>)>, String> {
    let spans = spans(footer).unwrap_or_default();
    let bytes: usize = spans.iter().map(|(key, value)| key.len() + value.len()).sum();
    if bytes > footer.len() {
        return Err(format!("metadata of {bytes} bytes in a footer of {}", footer.len()));
    }
    let mut entries = Vec::with_capacity(spans.len());
    for (key, value) in spans {
        let Ok(key) = String::from_utf8(footer[key].to_vec()) else { continue };
        entries.push((key, footer[value.clone()].to_vec()));
        footer[value].fill(b' ');
    }
    Ok(entries)
}

type Span = std::ops::Range<usize>;

/// Returns the spans of keys and values.
fn spans(footer: &[u8]) -> Option<Vec<(Span, Span)>> {
    let schema = child(footer, offset(footer, 0)?, SCHEMA)?;
    let entries = child(footer, schema, CUSTOM_METADATA)?;
    let count = number(footer, entries)?;
    let entry = |i: usize| {
        let entry = offset(footer, entries.checked_add(4)?.checked_add(i.checked_mul(4)?)?)?;
        Some((text(footer, child(footer, entry, KEY)?)?, text(footer, child(footer, entry, VALUE)?)?))
    };
    // A wrong count ends at the first entry beyond the footer.
    Some((0..count).map_while(entry).collect())
}

fn number(bytes: &[u8], at: usize) -> Option<usize> {
    let word = bytes.get(at..at.checked_add(4)?)?.first_chunk()?;
    usize::try_from(u32::from_le_bytes(*word)).ok()
}

/// Follows the offset at a position.
fn offset(bytes: &[u8], at: usize) -> Option<usize> {
    at.checked_add(number(bytes, at)?)
}

/// Returns the position of what a slot of a table refers to; `None` if the slot is empty.
fn child(bytes: &[u8], table: usize, slot: usize) -> Option<usize> {
    let back = i32::from_le_bytes(*bytes.get(table..)?.first_chunk()?);
    let vtable = usize::try_from(i64::try_from(table).ok()? - i64::from(back)).ok()?;
    let short = |at: usize| Some(usize::from(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?)));
    let place = 4 + 2 * slot;
    if place + 2 > short(vtable)? {
        return None;
    }
    match short(vtable.checked_add(place)?)? {
        0 => None,
        field => offset(bytes, table.checked_add(field)?),
    }
}

/// Returns the span of a text's or vector's bytes.
fn text(bytes: &[u8], at: usize) -> Option<Span> {
    let start = at.checked_add(4)?;
    let end = start.checked_add(number(bytes, at)?)?;
    (end <= bytes.len()).then_some(start..end)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a footer whose schema has a number of entries, all of which are the same key `a` and value of
    /// 99 bytes that are not UTF-8.
    fn footer(entries: u32) -> Vec<u8> {
        let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
        let shorts =
            |shorts: &[u16]| shorts.iter().flat_map(|short| short.to_le_bytes()).collect::<Vec<u8>>();
        // Tables begin with the distance of their vtable before them; other words are distances ahead.
        let root = [words(&[12]), shorts(&[8, 8, 0, 4]), words(&[8, 16])].concat();
        let schema = [shorts(&[10, 8, 0, 0, 4, 0]), words(&[12, 4])].concat();
        let vector = (0..entries).map(|i| 4 * (entries - i) + 8);
        let vector = words(&[&[entries][..], &vector.collect::<Vec<_>>()].concat());
        let entry = [shorts(&[8, 12, 4, 8]), words(&[8, 8, 12])].concat();
        let texts = [&words(&[1])[..], b"a\0\0\0", &words(&[99]), &[0xff; 99], &[0]].concat();
        [root, schema, vector, entry, texts].concat()
    }

    #[test]
    fn values_are_taken_once() {
        let mut one = footer(1);
        assert_eq!(take(&mut one), Ok(vec![("a".to_owned(), vec![0xff; 99])]));
        assert!(one.ends_with(&[[b' '; 99].as_slice(), &[0]].concat()));
        let found = take(&mut footer(100)).unwrap_err();
        assert_eq!(found, format!("metadata of 10000 bytes in a footer of {}", footer(100).len()));
        // The zero behind the value is not read.
        for length in 0..footer(1).len() - 1 {
            assert_eq!(take(&mut footer(1)[..length].to_vec()), Ok(Vec::new()), "{length}");
        }
    }
}
