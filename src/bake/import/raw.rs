//! Raw heights: `.r16` (`u16`) and `.r32` (`f32`), row by row, without a header.

use super::{ImportError, ImportSettings, Scale, reader, sized};
use crate::bake::{CodeMapping, HeightSource, SourceError};
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    U16,
    F32,
}

impl Kind {
    fn bytes(self) -> u64 {
        match self {
            Self::U16 => 2,
            Self::F32 => 4,
        }
    }
}

pub(super) fn open(
    path: &Path,
    settings: &ImportSettings,
    length: u64,
    kind: Kind,
) -> Result<Box<dyn HeightSource>, ImportError> {
    let Some(size) = settings.size else {
        return Err(ImportError::SizeWanted {
            path: path.to_owned(),
            suggestion: suggestion(length, kind),
        });
    };
    let [width, height] = size.map(u64::from);
    let size = sized(path, width, height)?;
    let wanted = width * height * kind.bytes();
    if length != wanted {
        return Err(ImportError::Length {
            path: path.to_owned(),
            found: length,
            wanted,
            size,
            sample: kind.bytes(),
        });
    }
    let (scale, note) = match kind {
        Kind::U16 => (
            Scale::share(settings, 65535.0),
            Scale::note(settings, "its numbers"),
        ),
        Kind::F32 => (Scale::metres(settings), None),
    };
    Ok(Box::new(Raw {
        path: path.to_owned(),
        reader: reader(path)?,
        size,
        kind,
        big_endian: settings.big_endian,
        scale,
        no_data: settings.no_data,
        bytes: vec![0; (width * kind.bytes()) as usize],
        note,
    }))
}

/// Raw files are square more often than not.
fn suggestion(length: u64, kind: Kind) -> String {
    let side = (length / kind.bytes()).isqrt();
    if side > 0 && side * side * kind.bytes() == length {
        format!(" (its length would fit {side}x{side})")
    } else {
        String::new()
    }
}

struct Raw {
    path: PathBuf,
    reader: BufReader<File>,
    size: [u32; 2],
    kind: Kind,
    big_endian: bool,
    scale: Scale,
    no_data: Option<f64>,
    bytes: Vec<u8>,
    note: Option<String>,
}

impl Raw {
    fn read_bytes(&mut self) -> Result<(), SourceError> {
        self.reader.read_exact(&mut self.bytes).map_err(|reason| {
            SourceError::new(
                self.path.display().to_string(),
                format!("it can't be read to its end: {reason}"),
            )
        })
    }

    fn code(&self, pair: &[u8]) -> u16 {
        let pair = [pair[0], pair[1]];
        if self.big_endian {
            u16::from_be_bytes(pair)
        } else {
            u16::from_le_bytes(pair)
        }
    }
}

impl HeightSource for Raw {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn size(&self) -> [u32; 2] {
        self.size
    }

    fn notes(&self) -> Vec<String> {
        self.note.iter().cloned().collect()
    }

    fn may_lack_data(&self) -> bool {
        self.kind == Kind::F32 || self.no_data.is_some()
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
        self.read_bytes()?;
        if let Some(codes) = self.codes() {
            for (sample, pair) in row.iter_mut().zip(self.bytes.chunks_exact(2)) {
                *sample = codes.sample(self.code(pair));
            }
            return Ok(());
        }
        for (sample, four) in row.iter_mut().zip(self.bytes.chunks_exact(4)) {
            let four = [four[0], four[1], four[2], four[3]];
            let value = if self.big_endian {
                f32::from_be_bytes(four)
            } else {
                f32::from_le_bytes(four)
            };
            let missing = self.no_data.is_some_and(|no_data| value == no_data as f32);
            *sample = if missing {
                f32::NAN
            } else {
                self.scale.apply(value.into())
            };
        }
        Ok(())
    }

    fn codes(&self) -> Option<CodeMapping> {
        (self.kind == Kind::U16).then(|| CodeMapping {
            scale_m: self.scale.scale,
            offset_m: self.scale.offset,
            no_data: self.no_data.and_then(super::whole),
        })
    }

    fn read_codes(&mut self, row: &mut [u16]) -> Result<(), SourceError> {
        self.read_bytes()?;
        let pairs = self.bytes.chunks_exact(2).map(|pair| [pair[0], pair[1]]);
        // A branch outside the loop leaves two loops that are as fast as memory.
        if self.big_endian {
            for (code, pair) in row.iter_mut().zip(pairs) {
                *code = u16::from_be_bytes(pair);
            }
        } else {
            for (code, pair) in row.iter_mut().zip(pairs) {
                *code = u16::from_le_bytes(pair);
            }
        }
        Ok(())
    }
}
