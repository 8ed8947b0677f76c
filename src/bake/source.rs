//! Where heights come from.

use thiserror::Error;

/// A height map that is read row by row, from the first to the last, as often as needed.
///
/// Heights are metres. Implement this to bake what no importer reads: a procedural function, a
/// database, another engine's format.
pub trait HeightSource: Send {
    /// What errors and reports call the source: a file's path, usually.
    fn name(&self) -> String;

    /// Samples in x (along a row) and z (rows).
    fn size(&self) -> [u32; 2];

    /// Metres between neighbouring samples, where the source knows.
    fn spacing_m(&self) -> Option<f64> {
        None
    }

    /// What was assumed about the source and may have to be told better, a sentence each.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }

    /// Whether a sample may be NaN, which says that there is no data. A source that says `false`
    /// is read once less.
    fn may_lack_data(&self) -> bool {
        true
    }

    /// Goes back before the first row.
    ///
    /// # Errors
    /// Where the source can't be opened again.
    fn rewind(&mut self) -> Result<(), SourceError>;

    /// Reads the next row, in metres; NaN where there is no data. `row` has as many elements as
    /// the source has samples in x.
    ///
    /// # Errors
    /// Where the source can't be read, or has no more rows.
    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError>;

    /// Passes over the next `rows` rows, whose samples nobody wants: a part of a bake starts in the
    /// middle. Reads them unless the source knows better.
    ///
    /// # Errors
    /// Where the source can't be read, or has fewer rows; a source that doesn't read them may say
    /// so with the next row instead.
    fn skip_rows(&mut self, rows: u32) -> Result<(), SourceError> {
        let width = self.size()[0] as usize;
        if self.codes().is_some() {
            let mut row = vec![0; width];
            return (0..rows).try_for_each(|_| self.read_codes(&mut row));
        }
        let mut row = vec![0.0; width];
        (0..rows).try_for_each(|_| self.read_row(&mut row))
    }

    /// How codes become metres, for a source whose samples are whole numbers of at most 16 bits.
    /// Reading those is several times as fast.
    fn codes(&self) -> Option<CodeMapping> {
        None
    }

    /// Reads the next row as codes. Called only where [`codes`](Self::codes) returns a mapping.
    ///
    /// # Errors
    /// Where the source can't be read, or has no more rows.
    fn read_codes(&mut self, row: &mut [u16]) -> Result<(), SourceError> {
        let _ = row;
        Err(SourceError::new(self.name(), "it has no codes"))
    }
}

/// What a 16-bit code stands for: `scale_m * code + offset_m` metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CodeMapping {
    /// Metres between two neighbouring codes.
    pub scale_m: f64,
    /// Metres of code 0.
    pub offset_m: f64,
    /// The code that says that there is no data.
    pub no_data: Option<u16>,
}

impl CodeMapping {
    /// The height of `code`, or `None` where it says that there is no data.
    #[must_use]
    pub fn height_m(&self, code: u16) -> Option<f64> {
        (self.no_data != Some(code)).then(|| self.scale_m * f64::from(code) + self.offset_m)
    }

    /// The height of `code` as [`HeightSource::read_row`] gives it.
    #[must_use]
    pub fn sample(&self, code: u16) -> f32 {
        self.height_m(code).map_or(f32::NAN, |height| height as f32)
    }
}

/// Why a source can't be read any further: a sentence that names it.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{name}: {reason}")]
pub struct SourceError {
    name: String,
    reason: String,
}

impl SourceError {
    /// The source `name` can't be read because of `reason`.
    #[must_use]
    pub fn new(name: impl Into<String>, reason: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            reason: reason.into(),
        }
    }
}

#[cfg(feature = "import")]
impl SourceError {
    /// What went wrong when the file was opened again.
    pub(super) fn from_import(path: &std::path::Path, error: &super::import::ImportError) -> Self {
        // The error's sentence begins with the path, and so does this one's.
        let name = path.display().to_string();
        let sentence = error.to_string();
        let reason = sentence.strip_prefix(&name).unwrap_or(&sentence);
        Self::new(name, format!("it{reason}"))
    }
}

/// A height map in memory, in metres.
#[derive(Clone, Debug)]
pub struct MemorySource {
    size: [u32; 2],
    heights_m: Vec<f32>,
    spacing_m: Option<f64>,
    next_row: usize,
}

impl MemorySource {
    /// A source of `size` samples whose heights `heights_m` lists row by row, in metres; NaN where
    /// there is no data. `None` where the number of heights doesn't match the size.
    #[must_use]
    pub fn new(size: [u32; 2], heights_m: Vec<f32>) -> Option<Self> {
        let samples = u64::from(size[0]) * u64::from(size[1]);
        (samples == heights_m.len() as u64).then_some(Self {
            size,
            heights_m,
            spacing_m: None,
            next_row: 0,
        })
    }

    /// Says how many metres lie between neighbouring samples.
    #[must_use]
    pub fn with_spacing_m(mut self, spacing_m: f64) -> Self {
        self.spacing_m = Some(spacing_m);
        self
    }
}

impl HeightSource for MemorySource {
    fn name(&self) -> String {
        "the height map in memory".to_owned()
    }

    fn size(&self) -> [u32; 2] {
        self.size
    }

    fn spacing_m(&self) -> Option<f64> {
        self.spacing_m
    }

    fn rewind(&mut self) -> Result<(), SourceError> {
        self.next_row = 0;
        Ok(())
    }

    fn skip_rows(&mut self, rows: u32) -> Result<(), SourceError> {
        self.next_row += rows as usize;
        Ok(())
    }

    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError> {
        let width = self.size[0] as usize;
        let start = self.next_row * width;
        let Some(heights) = self.heights_m.get(start..start + width) else {
            return Err(SourceError::new(self.name(), "it has no more rows"));
        };
        row.copy_from_slice(heights);
        self.next_row += 1;
        Ok(())
    }
}
