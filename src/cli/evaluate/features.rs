//! Features of other networks: NPY files `[N, D]`.

use std::io::{BufReader, Read};
use std::path::Path;

use anyhow::anyhow;
use npyz::{NpyHeader, Order};

use crate::cloud::npy::{Scalar, read_header_bytes};
use crate::error::FileError;
use crate::files::input::open_regular;
use crate::metrics::{Distance, FeatureSet, frechet_distance};

/// Of generated and true images.
pub(super) fn distance(generated: &Path, truth: &Path) -> anyhow::Result<Distance> {
    let (a, b) = (read(generated)?, read(truth)?);
    let distance = frechet_distance(&a, &b)
        .map_err(|error| anyhow!("{error}: {} and {}", generated.display(), truth.display()))?;
    Ok(Distance { distance, generated: a.len(), truth: b.len(), features: a.columns() })
}

/// The declared size is compared with the file's before anything is allocated.
fn read(path: &Path) -> Result<FeatureSet, FileError> {
    let (file, bytes) = open_regular(path)?;
    let mut reader = BufReader::new(file);
    let header_bytes = read_header_bytes(&mut reader, bytes, path)?;
    let header = NpyHeader::from_reader(header_bytes.as_slice())
        .map_err(|error| FileError::content("an NPY header", error.to_string(), path))?;
    let descr = header.dtype().descr();
    let scalar = Scalar::from_descr(&descr).filter(|scalar| *scalar != Scalar::F16);
    let scalar =
        scalar.ok_or_else(|| FileError::content("dtype <f4 or <f8", format!("dtype {descr}"), path))?;
    let (rows, columns) = match *header.shape() {
        [rows, columns] if columns > 0 => (rows, columns),
        _ => {
            let found = format!("shape {:?}", header.shape());
            return Err(FileError::content("features of shape [N, D]", found, path));
        }
    };
    if header.order() == Order::Fortran {
        return Err(FileError::content("C order", "Fortran order", path));
    }
    let needed = rows.checked_mul(columns).and_then(|count| count.checked_mul(scalar.bytes() as u64));
    let left = bytes - header_bytes.len() as u64;
    let needed = needed.filter(|needed| *needed <= left).ok_or_else(|| {
        let expected = format!("{rows} rows of {columns} numbers of {} bytes", scalar.bytes());
        FileError::content(expected, format!("{left} bytes of data"), path)
    })?;
    let mut data = vec![0; needed as usize];
    reader.read_exact(&mut data).map_err(FileError::io("read", path))?;
    let mut values = Vec::new();
    scalar.widen(&data, &mut values);
    FeatureSet::new(columns as usize, values)
        .ok_or_else(|| FileError::content("whole rows of features", "a part of one", path))
}
