//! PNG: grey of any depth, or heights packed into 8-bit colours.

use super::packed::Unpack;
use super::{
    Held, ImportError, ImportSettings, MAX_WHOLE_SAMPLES, Packing, Scale, damaged, reader, sized,
    unsuitable,
};
use crate::bake::{CodeMapping, HeightSource, SourceError};
use png::{BitDepth, ColorType, Decoder, Limits, Reader, Transformations};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

type Decoding = Reader<BufReader<File>>;

fn decoder(path: &Path) -> Result<Decoding, ImportError> {
    let mut decoder = Decoder::new_with_limits(reader(path)?, Limits { bytes: 1 << 28 });
    // Samples are data here: no expansion to 8 bits, no gamma, no palette look-ups.
    decoder.set_transformations(Transformations::IDENTITY);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let header = decoder
        .read_header_info()
        .map_err(|reason| damaged(path, "PNG", reason))?;
    sized(path, header.width.into(), header.height.into())?;
    decoder
        .read_info()
        .map_err(|reason| damaged(path, "PNG", reason))
}

pub(super) fn open(
    path: &Path,
    settings: &ImportSettings,
) -> Result<Box<dyn HeightSource>, ImportError> {
    let decoding = decoder(path)?;
    let info = decoding.info();
    let size = [info.width, info.height];
    let (pixel, note) = pixel(path, settings, info.color_type, info.bit_depth)?;
    let interlaced = info.interlaced;
    if interlaced && u64::from(size[0]) * u64::from(size[1]) > MAX_WHOLE_SAMPLES {
        return Err(unsuitable(
            path,
            format!("is interlaced and has {} x {} pixels", size[0], size[1]),
            "save it without interlacing, so that it can be read row by row",
        ));
    }
    Ok(Box::new(PngSource {
        path: path.to_owned(),
        decoding: Some(decoding),
        size,
        pixel,
        whole: None,
        interlaced,
        next_row: 0,
        note,
    }))
}

/// What a pixel holds.
#[derive(Clone, Copy)]
enum Pixel {
    /// A number of so many bits (1, 2, 4, 8 or 16).
    Grey { bits: u8, codes: CodeMapping },
    /// Three bytes that are one number, in so many bytes.
    Packed { bytes: usize, unpack: Unpack },
}

fn pixel(
    path: &Path,
    settings: &ImportSettings,
    colour: ColorType,
    depth: BitDepth,
) -> Result<(Pixel, Option<String>), ImportError> {
    let bits = depth as u8;
    if let Some(packing) = settings.packing {
        let bytes = match (colour, depth) {
            (ColorType::Rgb, BitDepth::Eight) => 3,
            (ColorType::Rgba, BitDepth::Eight) => 4,
            _ => {
                return Err(unsuitable(
                    path,
                    format!("has {bits} bit pixels of the type {colour:?}"),
                    format!("the packing {packing:?} needs 8 bit RGB; leave --packing away"),
                ));
            }
        };
        let note = (packing == Packing::Rgb24 && bytes == 4)
            .then(|| "its alpha channel is ignored".to_owned());
        let unpack = Unpack::new(path, packing, settings)?;
        return Ok((Pixel::Packed { bytes, unpack }, note));
    }
    if colour != ColorType::Grayscale {
        let advice = "save it as 8 or 16 bit grey, or say how heights are packed into its colours: \
                      --packing terrain-rgb, terrarium or rgb24";
        return Err(unsuitable(
            path,
            format!("holds colour ({colour:?}, {bits} bit) where grey is needed"),
            advice,
        ));
    }
    let largest = f64::from((1_u32 << bits) - 1);
    let scale = Scale::share(settings, largest);
    let codes = CodeMapping {
        scale_m: scale.scale,
        offset_m: scale.offset,
        no_data: settings.no_data.and_then(super::whole),
    };
    let note = Scale::note(settings, &format!("its {bits} bit numbers"));
    Ok((Pixel::Grey { bits, codes }, note))
}

struct PngSource {
    path: PathBuf,
    /// `None` only where going back to the start failed.
    decoding: Option<Decoding>,
    size: [u32; 2],
    pixel: Pixel,
    /// All rows, unpacked, of an interlaced file.
    whole: Option<Held>,
    interlaced: bool,
    next_row: u32,
    note: Option<String>,
}

impl PngSource {
    fn failed(&self, reason: impl ToString) -> SourceError {
        SourceError::new(
            self.name(),
            format!("the PNG file is damaged: {}", reason.to_string()),
        )
    }

    /// The next row's bytes, as the file has them.
    fn row_bytes(&mut self) -> Result<Vec<u8>, SourceError> {
        let name = self.path.display().to_string();
        let damaged =
            |reason: String| SourceError::new(&name, format!("the PNG file is damaged: {reason}"));
        let decoding = self
            .decoding
            .as_mut()
            .ok_or_else(|| damaged("it can't be opened again".to_owned()))?;
        let row = decoding
            .next_row()
            .map_err(|reason| damaged(reason.to_string()))?
            .ok_or_else(|| damaged("it has no more rows".to_owned()))?
            .data()
            .to_vec();
        self.next_row += 1;
        if self.next_row == self.size[1] {
            // Checksums of the last bytes come after them.
            decoding
                .finish()
                .map_err(|reason| damaged(reason.to_string()))?;
        }
        Ok(row)
    }

    /// Decodes an interlaced file as a whole.
    fn read_whole(&mut self) -> Result<(), SourceError> {
        if self.whole.is_some() {
            return Ok(());
        }
        let Some(decoding) = self.decoding.as_mut() else {
            return Err(self.failed("it can't be opened again"));
        };
        let Some(length) = decoding.output_buffer_size() else {
            return Err(self.failed("it is too large"));
        };
        let mut bytes = vec![0; length];
        if let Err(reason) = decoding.next_frame(&mut bytes) {
            return Err(self.failed(reason));
        }
        let row_length = length / self.size[1] as usize;
        let width = self.size[0] as usize;
        let rows = bytes.chunks_exact(row_length);
        self.whole = Some(match self.pixel {
            Pixel::Grey { bits, .. } => {
                let mut codes = vec![0; width * self.size[1] as usize];
                for (target, row) in codes.chunks_exact_mut(width).zip(rows) {
                    unpack_grey(row, bits, target);
                }
                Held::Codes(codes)
            }
            Pixel::Packed { bytes, unpack } => {
                let mut metres = vec![0.0; width * self.size[1] as usize];
                for (target, row) in metres.chunks_exact_mut(width).zip(rows) {
                    unpack_colours(row, bytes, unpack, target);
                }
                Held::Metres(metres)
            }
        });
        Ok(())
    }

    fn held_row<'a, T>(&self, all: &'a [T]) -> Result<&'a [T], SourceError> {
        let width = self.size[0] as usize;
        let first = self.next_row as usize * width;
        all.get(first..first + width)
            .ok_or_else(|| self.failed("it has no more rows"))
    }
}

impl HeightSource for PngSource {
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
        match self.pixel {
            Pixel::Grey { codes, .. } => codes.no_data.is_some(),
            Pixel::Packed { unpack, .. } => unpack.may_lack_data(),
        }
    }

    fn rewind(&mut self) -> Result<(), SourceError> {
        if self.next_row > 0 && self.whole.is_none() {
            self.decoding = None;
            let decoding = decoder(&self.path)
                .map_err(|error| SourceError::from_import(&self.path, &error))?;
            self.decoding = Some(decoding);
        }
        self.next_row = 0;
        Ok(())
    }

    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError> {
        match self.pixel {
            Pixel::Grey { codes, .. } => {
                let mut values = vec![0; row.len()];
                self.read_codes(&mut values)?;
                for (sample, code) in row.iter_mut().zip(values) {
                    *sample = codes.sample(code);
                }
            }
            Pixel::Packed { bytes, unpack } => {
                if self.interlaced {
                    self.read_whole()?;
                    if let Some(Held::Metres(all)) = &self.whole {
                        row.copy_from_slice(self.held_row(all)?);
                    }
                    self.next_row += 1;
                } else {
                    let data = self.row_bytes()?;
                    unpack_colours(&data, bytes, unpack, row);
                }
            }
        }
        Ok(())
    }

    fn codes(&self) -> Option<CodeMapping> {
        match self.pixel {
            Pixel::Grey { codes, .. } => Some(codes),
            Pixel::Packed { .. } => None,
        }
    }

    fn read_codes(&mut self, row: &mut [u16]) -> Result<(), SourceError> {
        let Pixel::Grey { bits, .. } = self.pixel else {
            return Err(self.failed("it has no codes"));
        };
        if self.interlaced {
            self.read_whole()?;
            if let Some(Held::Codes(all)) = &self.whole {
                row.copy_from_slice(self.held_row(all)?);
            }
            self.next_row += 1;
        } else {
            let data = self.row_bytes()?;
            unpack_grey(&data, bits, row);
        }
        Ok(())
    }
}

/// Reads numbers of `bits` bits, the most significant first.
fn unpack_grey(data: &[u8], bits: u8, row: &mut [u16]) {
    match bits {
        16 => {
            for (code, pair) in row.iter_mut().zip(data.chunks_exact(2)) {
                *code = u16::from_be_bytes([pair[0], pair[1]]);
            }
        }
        8 => {
            for (code, &byte) in row.iter_mut().zip(data) {
                *code = byte.into();
            }
        }
        _ => {
            let in_byte = usize::from(8 / bits);
            let mask = (1_u16 << bits) - 1;
            for (at, code) in row.iter_mut().enumerate() {
                let byte = data.get(at / in_byte).copied().unwrap_or_default();
                let shift = 8 - usize::from(bits) * (at % in_byte + 1);
                *code = u16::from(byte) >> shift & mask;
            }
        }
    }
}

fn unpack_colours(data: &[u8], bytes: usize, unpack: Unpack, row: &mut [f32]) {
    for (sample, colour) in row.iter_mut().zip(data.chunks_exact(bytes)) {
        *sample = unpack.height_m(colour[0], colour[1], colour[2]);
    }
}
