//! Turns a decoder's panic into an error.
//!
//! Decoders are fed files that nobody vouches for. Those used here don't panic that we know of,
//! but one that does must cost a sentence, not the program.

use super::{HeightSource, ImportError, damaged};
use crate::bake::{CodeMapping, SourceError};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

struct Guarded {
    inner: Box<dyn HeightSource>,
    /// After a panic the decoder's state can't be trusted.
    broken: bool,
}

/// Runs `open` and guards it and the source that it returns.
pub(super) fn open(
    path: &Path,
    format: &'static str,
    open: impl FnOnce() -> Result<Box<dyn HeightSource>, ImportError>,
) -> Result<Box<dyn HeightSource>, ImportError> {
    let inner = catch_unwind(AssertUnwindSafe(open))
        .unwrap_or_else(|_| Err(damaged(path, format, "the decoder gave up")))?;
    Ok(Box::new(Guarded {
        inner,
        broken: false,
    }))
}

impl Guarded {
    fn run(
        &mut self,
        work: impl FnOnce(&mut dyn HeightSource) -> Result<(), SourceError>,
    ) -> Result<(), SourceError> {
        let gave_up = |source: &dyn HeightSource| {
            Err(SourceError::new(
                source.name(),
                "the file is damaged: the decoder gave up",
            ))
        };
        if self.broken {
            return gave_up(&*self.inner);
        }
        match catch_unwind(AssertUnwindSafe(|| work(&mut *self.inner))) {
            Ok(result) => result,
            Err(_) => {
                self.broken = true;
                gave_up(&*self.inner)
            }
        }
    }
}

impl HeightSource for Guarded {
    fn name(&self) -> String {
        self.inner.name()
    }

    fn size(&self) -> [u32; 2] {
        self.inner.size()
    }

    fn spacing_m(&self) -> Option<f64> {
        self.inner.spacing_m()
    }

    fn notes(&self) -> Vec<String> {
        self.inner.notes()
    }

    fn may_lack_data(&self) -> bool {
        self.inner.may_lack_data()
    }

    fn rewind(&mut self) -> Result<(), SourceError> {
        self.run(|source| source.rewind())
    }

    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError> {
        self.run(|source| source.read_row(row))
    }

    fn skip_rows(&mut self, rows: u32) -> Result<(), SourceError> {
        self.run(|source| source.skip_rows(rows))
    }

    fn codes(&self) -> Option<CodeMapping> {
        self.inner.codes()
    }

    fn read_codes(&mut self, row: &mut [u16]) -> Result<(), SourceError> {
        self.run(|source| source.read_codes(row))
    }
}
