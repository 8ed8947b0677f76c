//! SRTM tiles: `.hgt`, square, `i16` metres, most significant byte first, -32768 for a void.

use super::{ImportError, ImportSettings, Scale, geo, reader, unsuitable};
use crate::bake::{CodeMapping, HeightSource, SourceError};
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

/// A code is the height plus 32768, so that codes are unsigned and keep their order.
const SIGN: u16 = 0x8000;
const VOID: i16 = -32768;

pub(super) fn open(
    path: &Path,
    settings: &ImportSettings,
    length: u64,
) -> Result<Box<dyn HeightSource>, ImportError> {
    let side: u32 = match length {
        2_884_802 => 1201,
        25_934_402 => 3601,
        _ => {
            return Err(unsuitable(
                path,
                format!("has {length} bytes"),
                "an SRTM tile has 1201 x 1201 samples in 2884802 bytes or 3601 x 3601 in 25934402",
            ));
        }
    };
    let mut notes = Vec::new();
    let degree = 1.0 / f64::from(side - 1);
    let spacing_m = match latitude(path) {
        Some(south) => {
            let [x, z] = geo::metres_per_degree(south + 0.5);
            let (spacing, note) = geo::square_spacing(x * degree, z * degree);
            notes.extend(note);
            spacing
        }
        None => {
            let spacing = geo::metres_per_degree(45.0)[1] * degree;
            notes.push(format!(
                "its name doesn't tell its latitude (N46E007.hgt would), so its samples are taken \
                 to lie {spacing:.1} m apart"
            ));
            spacing
        }
    };
    Ok(Box::new(Hgt {
        path: path.to_owned(),
        reader: reader(path)?,
        size: [side; 2],
        spacing_m,
        scale: Scale::metres(settings),
        bytes: vec![0; side as usize * 2],
        notes,
    }))
}

/// The latitude of the tile's southern edge, which its name begins with: `N46E007`, `S33W071`.
fn latitude(path: &Path) -> Option<f64> {
    let name = path.file_stem()?.to_str()?.to_ascii_uppercase();
    let sign = match name.chars().next()? {
        'N' => 1.0,
        'S' => -1.0,
        _ => return None,
    };
    let degrees: u8 = name.get(1..3)?.parse().ok()?;
    (degrees <= 90).then(|| sign * f64::from(degrees))
}

struct Hgt {
    path: PathBuf,
    reader: BufReader<File>,
    size: [u32; 2],
    spacing_m: f64,
    scale: Scale,
    bytes: Vec<u8>,
    notes: Vec<String>,
}

impl HeightSource for Hgt {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn size(&self) -> [u32; 2] {
        self.size
    }

    fn spacing_m(&self) -> Option<f64> {
        Some(self.spacing_m)
    }

    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    fn rewind(&mut self) -> Result<(), SourceError> {
        self.reader
            .rewind()
            .map_err(|reason| SourceError::new(self.name(), reason.to_string()))
    }

    fn skip_rows(&mut self, rows: u32) -> Result<(), SourceError> {
        let bytes = i64::from(rows) * self.bytes.len() as i64;
        self.reader
            .seek_relative(bytes)
            .map_err(|reason| SourceError::new(self.name(), reason.to_string()))
    }

    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError> {
        let mut codes = vec![0; row.len()];
        self.read_codes(&mut codes)?;
        let mapping = self.codes();
        for (sample, code) in row.iter_mut().zip(codes) {
            *sample = mapping.map_or(f32::NAN, |mapping| mapping.sample(code));
        }
        Ok(())
    }

    fn codes(&self) -> Option<CodeMapping> {
        Some(CodeMapping {
            scale_m: self.scale.scale,
            offset_m: self.scale.offset - self.scale.scale * f64::from(SIGN),
            no_data: Some(VOID as u16 ^ SIGN),
        })
    }

    fn read_codes(&mut self, row: &mut [u16]) -> Result<(), SourceError> {
        self.reader.read_exact(&mut self.bytes).map_err(|reason| {
            SourceError::new(
                self.path.display().to_string(),
                format!("it can't be read to its end: {reason}"),
            )
        })?;
        for (code, pair) in row.iter_mut().zip(self.bytes.chunks_exact(2)) {
            *code = u16::from_be_bytes([pair[0], pair[1]]) ^ SIGN;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_latitudes() {
        assert_eq!(latitude(Path::new("a/N44W072.hgt")), Some(44.0));
        assert_eq!(latitude(Path::new("s07e110.hgt")), Some(-7.0));
        assert_eq!(latitude(Path::new("N99E000.hgt")), None);
        assert_eq!(latitude(Path::new("Näh.hgt")), None);
        assert_eq!(latitude(Path::new("rainier.hgt")), None);
    }
}
