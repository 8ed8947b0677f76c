//! TIFF and GeoTIFF: one grey channel of integers or floats, in strips or tiles.

use super::{Held, ImportError, ImportSettings, Scale, damaged, geo, reader, sized, unsuitable};
use crate::bake::{CodeMapping, HeightSource, SourceError};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use tiff::decoder::{ChunkType, Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{ColorType, TiffError};

/// The most bytes that one strip or tile may take, compressed or not.
const MAX_CHUNK_BYTES: usize = 1 << 27;

type Decoding = Decoder<BufReader<File>>;

fn decoder(path: &Path) -> Result<Decoding, ImportError> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_CHUNK_BYTES;
    limits.intermediate_buffer_size = MAX_CHUNK_BYTES;
    // Room for the offsets of 2^22 strips or tiles.
    limits.ifd_value_size = 1 << 25;
    Decoder::new(reader(path)?)
        .map(|decoder| decoder.with_limits(limits))
        .map_err(|error| refused(path, &error))
}

/// Tells what is damaged from what is only unusual.
fn refused(path: &Path, error: &TiffError) -> ImportError {
    match error {
        TiffError::UnsupportedError(reason) => unsuitable(
            path,
            format!("is a TIFF file of a kind that can't be read ({reason})"),
            "save it as a single grey channel of 8, 16 or 32 bit numbers or 32 bit floats",
        ),
        TiffError::LimitsExceeded => large_chunks(path),
        _ => damaged(path, "TIFF", error),
    }
}

fn large_chunks(path: &Path) -> ImportError {
    unsuitable(
        path,
        "has strips or rows of tiles of more than 128 MiB",
        "save it with smaller strips or tiles, so that it can be read piece by piece",
    )
}

pub(super) fn open(
    path: &Path,
    settings: &ImportSettings,
) -> Result<Box<dyn HeightSource>, ImportError> {
    let mut decoding = decoder(path)?;
    let failed = |error: TiffError| refused(path, &error);
    let (width, height) = decoding.dimensions().map_err(failed)?;
    let size = sized(path, width.into(), height.into())?;
    let colour = decoding.colortype().map_err(failed)?;
    let ColorType::Gray(bits) = colour else {
        return Err(unsuitable(
            path,
            format!("holds colour or several channels ({colour:?}) where grey is needed"),
            "save it as a single grey channel",
        ));
    };
    let signed = decoding
        .find_tag_unsigned::<u16>(Tag::SampleFormat)
        .map_err(failed)?;
    let kind = match (signed.unwrap_or(1), bits) {
        (1, 8 | 16) => Kind::Unsigned,
        (2, 8 | 16) => Kind::Signed,
        (1 | 2, 32 | 64) | (3, 16 | 32 | 64) => Kind::Wide,
        (format, _) => {
            let format = match format {
                1 | 2 => "integers",
                3 => "floats",
                _ => "numbers of an unknown kind",
            };
            return Err(unsuitable(
                path,
                format!("has samples of {bits} bit {format}"),
                "save it with 8, 16 or 32 bit numbers or with 32 bit floats",
            ));
        }
    };
    let mut notes = Vec::new();
    let georeference = Georeference::read(&mut decoding);
    let (spacing_m, note) = georeference.spacing_m(size);
    notes.extend(note);

    // Georeferenced numbers are metres, whatever their type; numbers of a picture are shares.
    let scale = if matches!(kind, Kind::Unsigned) && georeference.pixel_scale.is_none() {
        notes.extend(Scale::note(settings, &format!("its {bits} bit numbers")));
        Scale::share(settings, f64::from((1_u32 << bits) - 1))
    } else {
        Scale::metres(settings)
    };
    let no_data = settings.no_data.or_else(|| no_data(&mut decoding));
    let chunk = decoding.chunk_dimensions();
    if chunk.0 == 0 || chunk.1 == 0 {
        return Err(damaged(path, "TIFF", "its strips or tiles have no size"));
    }
    // A band of them is held, so it must be bounded; a header may promise anything.
    let held_bytes = if kind == Kind::Wide { 4 } else { 2 };
    let held = u64::from(chunk.1.min(height)) * u64::from(width) * held_bytes;
    if held > MAX_CHUNK_BYTES as u64 {
        return Err(large_chunks(path));
    }
    let across = match decoding.get_chunk_type() {
        ChunkType::Strip => 1,
        ChunkType::Tile => width.div_ceil(chunk.0),
    };
    Ok(Box::new(TiffSource {
        path: path.to_owned(),
        decoding,
        size,
        spacing_m,
        kind,
        scale,
        no_data,
        across,
        chunk_rows: chunk.1.min(height),
        held: Held::Codes(Vec::new()),
        held_band: None,
        next_row: 0,
        notes,
    }))
}

/// What GDAL writes about missing data: a number, as text.
fn no_data(decoding: &mut Decoding) -> Option<f64> {
    let text = decoding.get_tag_ascii_string(Tag::GdalNodata).ok()?;
    let text = text.trim_matches(|c: char| c.is_whitespace() || c == '\0');
    text.parse().ok()
}

/// Where on Earth the file says it lies, as far as its scale needs it.
struct Georeference {
    pixel_scale: Option<[f64; 2]>,
    /// Latitude of the first row, where the file is in degrees.
    north: Option<f64>,
    geographic: bool,
    metres_per_unit: Option<f64>,
}

impl Georeference {
    fn read(decoding: &mut Decoding) -> Self {
        // What can't be read here is only missed: heights don't depend on it.
        let mut numbers = |tag| decoding.get_tag_f64_vec(tag).unwrap_or_default();
        let pixel_scale = match numbers(Tag::ModelPixelScaleTag)[..] {
            [x, z, ..] if x > 0.0 && z > 0.0 && x.is_finite() && z.is_finite() => Some([x, z]),
            _ => None,
        };
        let north = match numbers(Tag::ModelTiepointTag)[..] {
            [_, row, _, _, y, ..] => pixel_scale.map(|scale| y + row * scale[1]),
            _ => None,
        };
        let keys = decoding
            .get_tag_u16_vec(Tag::GeoKeyDirectoryTag)
            .unwrap_or_default();
        // Four numbers a key: which, where its value is (0: here), how many, the value.
        let key = |wanted: u16| {
            keys.chunks_exact(4)
                .skip(1)
                .find(|key| key[0] == wanted && key[1] == 0)
                .map(|key| key[3])
        };
        let (model_type, linear_units) = (key(1024), key(3076));
        Self {
            pixel_scale,
            north,
            geographic: model_type == Some(2),
            metres_per_unit: match linear_units {
                None | Some(9001) => Some(1.0),
                Some(9002) => Some(0.3048),
                Some(9003) => Some(1200.0 / 3937.0),
                Some(9036) => Some(1000.0),
                Some(_) => None,
            },
        }
    }

    /// Metres between samples, where the file tells, and what had to be assumed.
    fn spacing_m(&self, size: [u32; 2]) -> (Option<f64>, Option<String>) {
        let Some([x, z]) = self.pixel_scale else {
            return (None, None);
        };
        if self.geographic {
            let Some(north) = self.north else {
                let note = "it is in degrees, but doesn't say at which latitude; --spacing-m tells \
                            the distance between its samples";
                return (None, Some(note.to_owned()));
            };
            let middle = north - z * f64::from(size[1]) * 0.5;
            let [east, south] = geo::metres_per_degree(middle);
            let (spacing, note) = geo::square_spacing(x * east.max(1.0), z * south);
            return (Some(spacing), note);
        }
        match self.metres_per_unit {
            Some(unit) => {
                let (spacing, note) = geo::square_spacing(x * unit, z * unit);
                (Some(spacing), note)
            }
            None => {
                let note = "its units of length are unknown; --spacing-m tells the distance \
                            between its samples in metres";
                (None, Some(note.to_owned()))
            }
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// 8 or 16 bits, read as codes.
    Unsigned,
    /// 8 or 16 bits, read as codes that are 32768 higher.
    Signed,
    /// What doesn't fit a code.
    Wide,
}

struct TiffSource {
    path: PathBuf,
    decoding: Decoding,
    size: [u32; 2],
    spacing_m: Option<f64>,
    kind: Kind,
    scale: Scale,
    no_data: Option<f64>,
    /// Strips or tiles side by side.
    across: u32,
    chunk_rows: u32,
    /// A strip's, or a row of tiles', samples.
    held: Held,
    /// Which strip or row of tiles is held.
    held_band: Option<u32>,
    next_row: u32,
    notes: Vec<String>,
}

impl TiffSource {
    fn failed(&self, reason: impl ToString) -> SourceError {
        SourceError::new(self.name(), reason.to_string())
    }

    /// Decodes the strip or the row of tiles that holds the next row, and returns where in it the
    /// row begins.
    fn hold(&mut self) -> Result<usize, SourceError> {
        if self.next_row >= self.size[1] {
            return Err(self.failed("it has no more rows"));
        }
        let width = self.size[0] as usize;
        let band = self.next_row / self.chunk_rows;
        if self.held_band != Some(band) {
            self.held_band = None;
            let rows = self.chunk_rows.min(self.size[1] - band * self.chunk_rows) as usize;
            let mut held = match self.kind {
                Kind::Wide => Held::Metres(vec![0.0; rows * width]),
                _ => Held::Codes(vec![0; rows * width]),
            };
            for column in 0..self.across {
                let number = band * self.across + column;
                let chunk = self.decoding.read_chunk(number).map_err(|error| {
                    match refused(&self.path, &error) {
                        ImportError::Damaged { reason, .. } => {
                            self.failed(format!("the TIFF file is damaged: {reason}"))
                        }
                        other => SourceError::from_import(&self.path, &other),
                    }
                })?;
                let (chunk_width, chunk_rows) = self.decoding.chunk_data_dimensions(number);
                let left = (column * self.decoding.chunk_dimensions().0) as usize;
                let place = Place {
                    left,
                    columns: (chunk_width as usize).min(width - left),
                    rows: (chunk_rows as usize).min(rows),
                    stride: chunk_width as usize,
                    width,
                };
                if !self.place(&mut held, chunk, &place) {
                    return Err(self.failed("the TIFF file is damaged: a strip or tile is short"));
                }
            }
            self.held = held;
            self.held_band = Some(band);
        }
        Ok((self.next_row - band * self.chunk_rows) as usize * width)
    }

    /// Copies a decoded strip or tile to its place; false where it holds too few samples.
    fn place(&self, held: &mut Held, chunk: DecodingResult, place: &Place) -> bool {
        let Self { scale, no_data, .. } = *self;
        // Compared before any rounding to `f32`, except in files of `f32`, whose no-data text
        // has often more digits than they.
        let metres = |value: f64| match no_data {
            Some(missing) if value == missing => f32::NAN,
            _ => scale.apply(value),
        };
        match (held, chunk) {
            (Held::Codes(out), DecodingResult::U8(data)) => place.copy(out, &data, u16::from),
            (Held::Codes(out), DecodingResult::U16(data)) => place.copy(out, &data, |code| code),
            (Held::Codes(out), DecodingResult::I8(data)) => {
                place.copy(out, &data, |value| i16::from(value) as u16 ^ SIGN)
            }
            (Held::Codes(out), DecodingResult::I16(data)) => {
                place.copy(out, &data, |value| value as u16 ^ SIGN)
            }
            (Held::Metres(out), DecodingResult::U32(data)) => {
                place.copy(out, &data, |value| metres(value.into()))
            }
            (Held::Metres(out), DecodingResult::I32(data)) => {
                place.copy(out, &data, |value| metres(value.into()))
            }
            (Held::Metres(out), DecodingResult::U64(data)) => {
                place.copy(out, &data, |value| metres(value as f64))
            }
            (Held::Metres(out), DecodingResult::I64(data)) => {
                place.copy(out, &data, |value| metres(value as f64))
            }
            (Held::Metres(out), DecodingResult::F16(data)) => {
                place.copy(out, &data, |value| metres(value.to_f64()))
            }
            (Held::Metres(out), DecodingResult::F32(data)) => place.copy(out, &data, |value| {
                if no_data.is_some_and(|missing| value == missing as f32) {
                    f32::NAN
                } else {
                    scale.apply(value.into())
                }
            }),
            (Held::Metres(out), DecodingResult::F64(data)) => place.copy(out, &data, metres),
            _ => false,
        }
    }
}

/// What turns a signed number into a code that keeps the order.
const SIGN: u16 = 0x8000;

/// Where a strip or tile lies in the held rows.
struct Place {
    left: usize,
    columns: usize,
    rows: usize,
    /// Samples from one row of the strip or tile to the next.
    stride: usize,
    /// Samples from one held row to the next.
    width: usize,
}

impl Place {
    fn copy<S: Copy, T>(&self, out: &mut [T], data: &[S], convert: impl Fn(S) -> T) -> bool {
        let rows = data.chunks_exact(self.stride);
        if rows.len() < self.rows {
            return false;
        }
        for (target, row) in out.chunks_exact_mut(self.width).zip(rows).take(self.rows) {
            let target = &mut target[self.left..self.left + self.columns];
            for (sample, &value) in target.iter_mut().zip(row) {
                *sample = convert(value);
            }
        }
        true
    }
}

impl HeightSource for TiffSource {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn size(&self) -> [u32; 2] {
        self.size
    }

    fn spacing_m(&self) -> Option<f64> {
        self.spacing_m
    }

    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    fn may_lack_data(&self) -> bool {
        self.kind == Kind::Wide || self.no_data.is_some()
    }

    fn rewind(&mut self) -> Result<(), SourceError> {
        // Strips and tiles are read in any order.
        self.next_row = 0;
        Ok(())
    }

    fn skip_rows(&mut self, rows: u32) -> Result<(), SourceError> {
        self.next_row = self.next_row.saturating_add(rows);
        Ok(())
    }

    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError> {
        let first = self.hold()?;
        let codes = self.codes();
        match (&self.held, codes) {
            (Held::Metres(all), _) => row.copy_from_slice(&all[first..first + row.len()]),
            (Held::Codes(all), Some(codes)) => {
                for (sample, &code) in row.iter_mut().zip(&all[first..]) {
                    *sample = codes.sample(code);
                }
            }
            (Held::Codes(_), None) => return Err(self.failed("it has no codes")),
        }
        self.next_row += 1;
        Ok(())
    }

    fn codes(&self) -> Option<CodeMapping> {
        let Scale { scale, offset } = self.scale;
        match self.kind {
            Kind::Unsigned => Some(CodeMapping {
                scale_m: scale,
                offset_m: offset,
                no_data: self.no_data.and_then(super::whole),
            }),
            Kind::Signed => Some(CodeMapping {
                scale_m: scale,
                offset_m: offset - scale * f64::from(SIGN),
                no_data: self
                    .no_data
                    .and_then(|value| super::whole(value + f64::from(SIGN))),
            }),
            Kind::Wide => None,
        }
    }

    fn read_codes(&mut self, row: &mut [u16]) -> Result<(), SourceError> {
        let first = self.hold()?;
        let Held::Codes(all) = &self.held else {
            return Err(self.failed("it has no codes"));
        };
        row.copy_from_slice(&all[first..first + row.len()]);
        self.next_row += 1;
        Ok(())
    }
}
