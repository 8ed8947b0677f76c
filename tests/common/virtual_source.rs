//! An asset source whose files come late, damaged or not at all, by a clock that counts frames.

use bevy::asset::io::{
    AssetReader, AssetReaderError, AssetSourceBuilder, PathStream, Reader, VecReader,
};
use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex};

/// What becomes of a read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    Good,
    /// The read fails.
    Failure,
    /// A byte is another one.
    Corrupt,
    /// The file seems not to be there.
    Missing,
}

/// How late a read is, in frames, and what becomes of it, given the path and how often it was read
/// before.
pub type Faults = dyn Fn(&Path, u32) -> (u64, Outcome) + Send + Sync;

#[derive(Default)]
struct Clock {
    frame: u64,
    /// Frames at which reads that are under way will end.
    waiting: Vec<u64>,
}

/// The clock and the faults of a source, shared with the test.
#[derive(Clone)]
pub struct VirtualSource {
    root: PathBuf,
    clock: Arc<(Mutex<Clock>, Condvar)>,
    reads: Arc<Mutex<HashMap<PathBuf, u32>>>,
    faults: Arc<Faults>,
}

impl VirtualSource {
    pub fn new(
        root: &Path,
        faults: impl Fn(&Path, u32) -> (u64, Outcome) + Send + Sync + 'static,
    ) -> Self {
        Self {
            root: root.to_owned(),
            clock: Arc::default(),
            reads: Arc::default(),
            faults: Arc::new(faults),
        }
    }

    pub fn builder(&self) -> AssetSourceBuilder {
        let source = self.clone();
        AssetSourceBuilder::new(move || Box::new(source.clone()))
    }

    /// Ends a frame, and waits until every read that is due has come to its end.
    pub fn tick(&self) {
        let (clock, changed) = &*self.clock;
        let mut now = clock.lock().unwrap();
        now.frame += 1;
        changed.notify_all();
        while now.waiting.iter().any(|&due| due <= now.frame) {
            now = changed.wait(now).unwrap();
        }
    }

    /// How many reads there were.
    pub fn read_count(&self) -> u64 {
        self.reads
            .lock()
            .unwrap()
            .values()
            .map(|&n| u64::from(n))
            .sum()
    }

    fn read_late(&self, path: &Path) -> Result<Vec<u8>, AssetReaderError> {
        let before = {
            let mut reads = self.reads.lock().unwrap();
            let count = reads.entry(path.to_owned()).or_default();
            *count += 1;
            *count - 1
        };
        let (late, outcome) = (self.faults)(path, before);
        let (clock, changed) = &*self.clock;
        let mut now = clock.lock().unwrap();
        let due = now.frame + late;
        now.waiting.push(due);
        while now.frame < due {
            now = changed.wait(now).unwrap();
        }
        drop(now);
        let bytes = match outcome {
            Outcome::Failure => Err(io::Error::other("the disk is on fire")),
            Outcome::Missing => Err(io::ErrorKind::NotFound.into()),
            Outcome::Good => std::fs::read(self.root.join(path)),
            Outcome::Corrupt => std::fs::read(self.root.join(path)).map(|mut bytes| {
                let at = bytes.len() / 2;
                bytes[at] ^= 16;
                bytes
            }),
        };
        let mut now = clock.lock().unwrap();
        let at = now.waiting.iter().position(|&other| other == due);
        now.waiting.swap_remove(at.unwrap());
        changed.notify_all();
        bytes.map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => AssetReaderError::NotFound(path.to_owned()),
            _ => error.into(),
        })
    }
}

impl AssetReader for VirtualSource {
    async fn read<'a>(&'a self, path: &'a Path) -> Result<impl Reader + 'a, AssetReaderError> {
        let (source, path) = (self.clone(), path.to_owned());
        let bytes = blocking::unblock(move || source.read_late(&path)).await?;
        Ok(VecReader::new(bytes))
    }

    async fn read_meta<'a>(&'a self, path: &'a Path) -> Result<impl Reader + 'a, AssetReaderError> {
        Err::<VecReader, _>(AssetReaderError::NotFound(path.to_owned()))
    }

    async fn read_directory<'a>(
        &'a self,
        path: &'a Path,
    ) -> Result<Box<PathStream>, AssetReaderError> {
        Err(AssetReaderError::NotFound(path.to_owned()))
    }

    async fn is_directory<'a>(&'a self, _path: &'a Path) -> Result<bool, AssetReaderError> {
        Ok(false)
    }
}
