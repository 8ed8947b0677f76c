//! OpenEXR: one channel of 16 or 32 bit floats (or 32 bit integers), or a grey picture in three.

use super::{
    ImportError, ImportSettings, MAX_WHOLE_SAMPLES, Scale, damaged, reader, sized, unsuitable,
};
use crate::bake::{HeightSource, SourceError};
use exr::block::UncompressedBlock;
use exr::block::reader::{ChunksReader, FilteredChunksReader, SequentialBlockDecompressor};
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelList, LineOrder, SampleType};
use exr::meta::header::Header;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

type Decoding = SequentialBlockDecompressor<FilteredChunksReader<BufReader<File>>>;

/// Which channels of a file hold heights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channels {
    One(usize),
    /// Red, green and blue, which must be equal.
    Grey([usize; 3]),
}

impl Channels {
    fn all(self) -> [usize; 3] {
        match self {
            Self::One(channel) => [channel; 3],
            Self::Grey(channels) => channels,
        }
    }
}

/// Checks the header; returns the size, the channels and a note.
fn check(
    path: &Path,
    headers: &[Header],
) -> Result<([u32; 2], Channels, Option<String>), ImportError> {
    let [header, others @ ..] = headers else {
        return Err(damaged(path, "OpenEXR", "it has no layer"));
    };
    if header.deep {
        return Err(unsuitable(
            path,
            "holds deep data, several samples a pixel",
            "save it flat",
        ));
    }
    let size = sized(
        path,
        header.layer_size.x() as u64,
        header.layer_size.y() as u64,
    )?;
    let list = &header.channels.list;
    let names = || {
        let names: Vec<String> = list
            .iter()
            .map(|channel| channel.name.to_string())
            .collect();
        names.join(", ")
    };
    let find = |wanted: &str| {
        list.iter()
            .position(|channel| channel.name.to_string().eq_ignore_ascii_case(wanted))
    };
    let single = if list.len() == 1 { Some(0) } else { None };
    let grey = find("R").zip(find("G")).zip(find("B"));
    let one = single
        .or_else(|| find("Y"))
        .or_else(|| find("Z"))
        .or_else(|| find("height"));
    let (channels, mut note) = match (one, grey) {
        (Some(channel), _) => (Channels::One(channel), None),
        (None, Some(((red, green), blue))) => (
            Channels::Grey([red, green, blue]),
            Some("its red, green and blue are read as one grey channel".to_owned()),
        ),
        (None, None) => {
            return Err(unsuitable(
                path,
                format!("has the channels {}", names()),
                "heights are looked for in Y, Z, height, the only channel, or equal R, G and B",
            ));
        }
    };
    if channels
        .all()
        .iter()
        .any(|&channel| list[channel].sampling != exr::math::Vec2(1, 1))
    {
        return Err(unsuitable(
            path,
            "has fewer samples than pixels in its channel",
            "save it without subsampling",
        ));
    }
    if !others.is_empty() {
        note = Some(format!(
            "it has {} layers, of which the first is read",
            headers.len()
        ));
    }
    Ok((size, channels, note))
}

fn decoder(path: &Path) -> Result<Decoding, ImportError> {
    let failed = |reason: exr::error::Error| damaged(path, "OpenEXR", reason);
    let reader = exr::block::read(reader(path)?, true).map_err(failed)?;
    // Before the tables of blocks are read, which are as long as the header says.
    check(path, reader.headers())?;
    let chunks = reader
        .filter_chunks(true, |_, tile, block| {
            block.layer == 0 && tile.level_index == exr::math::Vec2(0, 0)
        })
        .map_err(failed)?;
    Ok(chunks.sequential_decompressor(true))
}

pub(super) fn open(
    path: &Path,
    settings: &ImportSettings,
) -> Result<Box<dyn HeightSource>, ImportError> {
    let decoding = decoder(path)?;
    let headers = &decoding.meta_data().headers;
    let (size, channels, note) = check(path, headers)?;
    let streams = headers[0].blocks == BlockDescription::ScanLines
        && headers[0].line_order == LineOrder::Increasing;
    if !streams && u64::from(size[0]) * u64::from(size[1]) > MAX_WHOLE_SAMPLES {
        return Err(unsuitable(
            path,
            format!(
                "has {} x {} pixels in tiles or from the bottom up",
                size[0], size[1]
            ),
            "save it as scan lines from the top down, so that it can be read row by row",
        ));
    }
    Ok(Box::new(ExrSource {
        path: path.to_owned(),
        list: headers[0].channels.clone(),
        decoding: Some(decoding),
        size,
        channels,
        scale: Scale::metres(settings),
        no_data: settings.no_data.map(|value| value as f32),
        streams,
        held: Vec::new(),
        held_first: 0,
        next_row: 0,
        note,
    }))
}

struct ExrSource {
    path: PathBuf,
    list: ChannelList,
    decoding: Option<Decoding>,
    size: [u32; 2],
    channels: Channels,
    scale: Scale,
    no_data: Option<f32>,
    /// Whether blocks come in the order of their rows.
    streams: bool,
    /// Rows decoded: one block of a file that streams, or all of them.
    held: Vec<f32>,
    held_first: u32,
    next_row: u32,
    note: Option<String>,
}

impl ExrSource {
    fn failed(&self, reason: impl ToString) -> SourceError {
        SourceError::new(
            self.name(),
            format!("the OpenEXR file is damaged: {}", reason.to_string()),
        )
    }

    fn next_block(&mut self) -> Result<UncompressedBlock, SourceError> {
        let block = self
            .decoding
            .as_mut()
            .and_then(Decoding::decompress_next_block)
            .ok_or_else(|| self.failed("it has no more rows"))?;
        block.map_err(|reason| self.failed(reason))
    }

    /// Copies a block's heights to their place in the held rows.
    fn place(&mut self, block: &UncompressedBlock) -> Result<(), SourceError> {
        let width = self.size[0] as usize;
        let [first_channel, others @ ..] = self.channels.all();
        let mut line_samples = vec![0.0_f32; block.index.pixel_size.x()];
        // The channels of a line come one after another, in the file's order; where several are
        // read, they are compared as they come.
        let mut colours: [Vec<f32>; 3] = Default::default();
        let name = self.name();
        for line in block.lines(&self.list) {
            let channel = line.location.channel;
            if channel != first_channel && !others.contains(&channel) {
                continue;
            }
            let kind = self.list.list[channel].sample_type;
            read_line(line, kind, &mut line_samples).map_err(|reason| self.failed(reason))?;
            if let Channels::Grey(channels) = self.channels {
                let which = channels.iter().position(|&c| c == channel).unwrap_or(0);
                colours[which].clone_from(&line_samples);
                if colours.iter().any(Vec::is_empty) {
                    continue;
                }
                let equal =
                    |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
                if !equal(&colours[0], &colours[1]) || !equal(&colours[0], &colours[2]) {
                    return Err(SourceError::new(
                        name,
                        "it holds colour where grey is needed: red, green and blue differ; save \
                         its heights as one channel, Y",
                    ));
                }
                for colour in &mut colours {
                    colour.clear();
                }
            }
            let row = line.location.position.y() as u32;
            let column = line.location.position.x();
            let start = row
                .checked_sub(self.held_first)
                .map(|row| row as usize * width + column);
            let target = start
                .filter(|_| column + line_samples.len() <= width)
                .and_then(|start| self.held.get_mut(start..start + line_samples.len()));
            let Some(target) = target else {
                return Err(self.failed("a block lies outside the picture"));
            };
            for (out, &value) in target.iter_mut().zip(&line_samples) {
                *out = if self.no_data == Some(value) {
                    f32::NAN
                } else {
                    self.scale.apply(value.into())
                };
            }
        }
        Ok(())
    }

    /// Sees to it that the next row is held, and returns where it begins.
    fn hold(&mut self) -> Result<usize, SourceError> {
        let width = self.size[0] as usize;
        if self.next_row >= self.size[1] {
            return Err(self.failed("it has no more rows"));
        }
        let start = |source: &Self| {
            let row = source.next_row.checked_sub(source.held_first)? as usize;
            (row * width < source.held.len()).then_some(row * width)
        };
        if let Some(start) = start(self) {
            return Ok(start);
        }
        if self.streams {
            let block = self.next_block()?;
            if block.index.pixel_position.y() != self.next_row as usize {
                return Err(self.failed("its blocks are out of order"));
            }
            self.held_first = self.next_row;
            self.held = vec![0.0; block.index.pixel_size.y() * width];
            self.place(&block)?;
        } else {
            self.held_first = 0;
            let mut missing = self
                .size
                .map(|side| side as usize)
                .iter()
                .product::<usize>();
            self.held = vec![0.0; missing];
            while missing > 0 {
                let block = self.next_block()?;
                self.place(&block)?;
                missing = missing.saturating_sub(block.index.pixel_size.area());
            }
        }
        start(self).ok_or_else(|| self.failed("a block has no rows"))
    }
}

/// Reads a line's samples as floats.
fn read_line(
    line: exr::block::lines::LineRef<'_>,
    kind: SampleType,
    out: &mut [f32],
) -> exr::error::UnitResult {
    match kind {
        SampleType::F32 => line.read_samples_into_slice(out)?,
        SampleType::F16 => {
            for (out, sample) in out.iter_mut().zip(line.read_samples::<exr::prelude::f16>()) {
                *out = sample?.to_f32();
            }
        }
        SampleType::U32 => {
            for (out, sample) in out.iter_mut().zip(line.read_samples::<u32>()) {
                *out = sample? as f32;
            }
        }
    }
    Ok(())
}

impl HeightSource for ExrSource {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn size(&self) -> [u32; 2] {
        self.size
    }

    fn notes(&self) -> Vec<String> {
        self.note.iter().cloned().collect()
    }

    fn rewind(&mut self) -> Result<(), SourceError> {
        if self.next_row > 0 && self.streams {
            self.decoding = None;
            let decoding = decoder(&self.path)
                .map_err(|error| SourceError::from_import(&self.path, &error))?;
            self.decoding = Some(decoding);
            self.held = Vec::new();
        }
        self.next_row = 0;
        Ok(())
    }

    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError> {
        let start = self.hold()?;
        row.copy_from_slice(&self.held[start..start + row.len()]);
        self.next_row += 1;
        Ok(())
    }
}
