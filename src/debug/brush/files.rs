//! Saves of the log and images of stamps, read and written in the background.

use super::tool::TerrainBrush;
use crate::edit::{EditLog, StampImage, TerrainEdits};
use crate::stream::TerrainState;
use bevy::asset::RenderAssetUsages;
use bevy::image::{CompressedImageFormats, Image, ImageSampler, ImageType};
use bevy::prelude::*;
use bevy::tasks::futures::check_ready;
use bevy::tasks::{AsyncComputeTaskPool, Task, TaskPool};
use std::io::Read;
use std::path::{Path, PathBuf};

/// What a save is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EditFormat {
    /// [`EditLog::save`]: small, and quick to load.
    Binary,
    /// [`EditLog::save_ron`]: to be read by people.
    Ron,
}

/// What came of a file, as one sentence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Said {
    pub(super) text: String,
    pub(super) is_error: bool,
}

enum Done {
    Saved { edits: usize, bytes: u64 },
    Loaded { terrain: Entity, log: Box<EditLog> },
    Failed(String),
}

/// Files that are being read or written for the brush, and what came of the last ones.
#[derive(Resource, Default)]
pub struct BrushFiles {
    log: Option<(PathBuf, Task<Done>)>,
    image: Option<(PathBuf, Task<Result<StampImage, String>>)>,
    pub(super) log_said: Option<Said>,
    pub(super) image_said: Option<Said>,
    /// What a loaded log took the place of.
    replaced: Option<(Entity, EditLog)>,
}

impl BrushFiles {
    /// Whether a log is being saved or loaded; the next one waits until it is done.
    #[must_use]
    pub const fn is_busy(&self) -> bool {
        self.log.is_some()
    }

    /// Whether a stamp's image is being read.
    #[must_use]
    pub const fn is_reading_stamp(&self) -> bool {
        self.image.is_some()
    }

    /// The last sentence about a log's file.
    #[must_use]
    pub fn log_message(&self) -> Option<&str> {
        self.log_said.as_ref().map(|said| said.text.as_str())
    }

    /// The last sentence about a stamp's image.
    #[must_use]
    pub fn stamp_message(&self) -> Option<&str> {
        self.image_said.as_ref().map(|said| said.text.as_str())
    }

    /// How many edits of `terrain` a loaded log took the place of, which can be brought back.
    pub(super) fn replaced(&self, terrain: Entity) -> Option<usize> {
        let (of, log) = self.replaced.as_ref()?;
        (*of == terrain).then(|| log.active_count())
    }
}

fn said(text: impl Into<String>, is_error: bool) -> Option<Said> {
    let text = text.into();
    Some(Said { text, is_error })
}

/// Saves the log of `terrain` at `path` in the background, as [`EditLog::save`] does: what was saved there
/// before is replaced as a whole or not at all. [`BrushFiles::log_message`] says what came of it.
pub fn save_edits(world: &mut World, terrain: Entity, path: &Path, format: EditFormat) {
    let log = world.get::<TerrainEdits>(terrain);
    let log = log.and_then(TerrainEdits::log).cloned();
    let mut files = world.resource_mut::<BrushFiles>();
    if files.is_busy() {
        return;
    }
    let Some(log) = log else {
        files.log_said = said("there are no edits yet that could be saved", true);
        return;
    };
    let to = path.to_owned();
    files.log_said = None;
    let save = async move {
        let saved = match format {
            EditFormat::Binary => log.save(&to),
            EditFormat::Ron => log.save_ron(&to),
        };
        match saved {
            Ok(()) => Done::Saved {
                edits: log.active_count(),
                bytes: std::fs::metadata(&to).map_or(0, |file| file.len()),
            },
            Err(error) => Done::Failed(error.to_string()),
        }
    };
    files.log = Some((path.to_owned(), spawn(save)));
}

/// Loads a log in the background and puts it in the place of that of `terrain`, if it is that
/// terrain's. [`BrushFiles::log_message`] says what came of it.
pub fn load_edits(world: &mut World, terrain: Entity, path: &Path) {
    let mut files = world.resource_mut::<BrushFiles>();
    if files.is_busy() {
        return;
    }
    let from = path.to_owned();
    files.log_said = None;
    let load = async move {
        match EditLog::load(&from) {
            Ok(log) => Done::Loaded {
                terrain,
                log: Box::new(log),
            },
            Err(error) => Done::Failed(error.to_string()),
        }
    };
    files.log = Some((path.to_owned(), spawn(load)));
}

/// Reads a square PNG of 2 to 1024 pixels a side in the background, as [`TerrainBrush::image`]: black
/// changes nothing, white is a full sample. [`BrushFiles::stamp_message`] says what came of it.
pub fn read_stamp(world: &mut World, path: &Path) {
    let mut files = world.resource_mut::<BrushFiles>();
    let from = path.to_owned();
    files.image_said = None;
    files.image = Some((path.to_owned(), spawn(async move { read_image(&from) })));
}

/// Puts the log back that the last loaded one took the place of; that one can be brought back in turn.
pub(super) fn bring_back(world: &mut World, terrain: Entity) {
    let mut files = world.resource_mut::<BrushFiles>();
    if let Some((of, log)) = files.replaced.take() {
        if of == terrain {
            replace(world, terrain, log);
        } else {
            files.replaced = Some((of, log));
        }
    }
}

fn spawn<T: Send + 'static>(work: impl Future<Output = T> + Send + 'static) -> Task<T> {
    AsyncComputeTaskPool::get_or_init(TaskPool::default).spawn(work)
}

pub(super) fn is_busy(files: Res<BrushFiles>) -> bool {
    files.log.is_some() || files.image.is_some()
}

/// Takes what has been read and written.
pub(super) fn finish(world: &mut World) {
    let mut files = world.resource_mut::<BrushFiles>();
    if let Some((path, task)) = &mut files.image
        && let Some(read) = check_ready(task)
    {
        let path = path.clone();
        files.image = None;
        match read {
            Ok(image) => {
                let text = format!("{} has {} pixels a side", path.display(), image.side);
                files.image_said = said(text, false);
                world.resource_mut::<TerrainBrush>().image = Some(image);
            }
            Err(error) => files.image_said = said(error, true),
        }
    }
    let mut files = world.resource_mut::<BrushFiles>();
    if let Some((path, task)) = &mut files.log
        && let Some(done) = check_ready(task)
    {
        let path = path.clone();
        files.log = None;
        let message = match done {
            Done::Failed(error) => said(error, true),
            Done::Saved { edits, bytes } => said(
                format!("saved {edits} edits in {} ({bytes} bytes)", path.display()),
                false,
            ),
            Done::Loaded { terrain, log } => put(world, terrain, *log, &path),
        };
        world.resource_mut::<BrushFiles>().log_said = message;
    }
}

fn put(world: &mut World, terrain: Entity, log: EditLog, path: &Path) -> Option<Said> {
    let path = path.display();
    let Some(state) = world.get::<TerrainState>(terrain) else {
        return said(
            format!("{path} isn't used: its terrain is gone, or hasn't loaded"),
            true,
        );
    };
    if let Err(error) = log.check_terrain(&state.manifest().file) {
        return said(format!("{path} isn't used: {error}"), true);
    }
    let text = format!("loaded {} edits from {path}", log.active_count());
    replace(world, terrain, log);
    said(text, false)
}

fn replace(world: &mut World, terrain: Entity, log: EditLog) {
    let old = world.get::<TerrainEdits>(terrain);
    let old = old.and_then(TerrainEdits::log).cloned();
    if let Ok(mut entity) = world.get_entity_mut(terrain) {
        entity.insert(TerrainEdits::new(log));
        world.resource_mut::<TerrainBrush>().marked = None;
        let kept = old.filter(|log| !log.is_empty());
        world.resource_mut::<BrushFiles>().replaced = kept.map(|log| (terrain, log));
    }
}

/// The most bytes of a file that is taken for an image: more than any that can be used has.
const MOST_BYTES: u64 = 64 << 20;
/// The start of a PNG, up to the name of its first chunk, and where its width stands.
const PNG_START: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
const WIDTH_AT: usize = 16;

fn read_image(path: &Path) -> Result<StampImage, String> {
    let name = path.display();
    let unreadable = |error: std::io::Error| format!("{name} can't be read: {error}");
    let file = std::fs::File::open(path).map_err(unreadable)?;
    let metadata = file.metadata().map_err(unreadable)?;
    if !metadata.is_file() || metadata.len() > MOST_BYTES {
        return Err(format!(
            "{name} can't be a stamp: it is no file of at most {} MiB",
            MOST_BYTES >> 20
        ));
    }
    let mut bytes = Vec::new();
    file.take(MOST_BYTES)
        .read_to_end(&mut bytes)
        .map_err(unreadable)?;
    let number = |at: usize| -> Option<u32> {
        let bytes = bytes.get(at..at + 4)?;
        Some(u32::from_be_bytes(bytes.try_into().ok()?))
    };
    let (true, Some(width), Some(height)) = (
        bytes.starts_with(&PNG_START),
        number(WIDTH_AT),
        number(WIDTH_AT + 4),
    ) else {
        return Err(format!("{name} can't be a stamp: it is no PNG; convert it"));
    };
    // Before the decoder makes room for what the header promises.
    if width != height || !(2..=1024).contains(&width) {
        return Err(format!(
            "{name} can't be a stamp: it has {width} x {height} pixels where a square of 2 to 1024 a \
             side is wanted; crop or scale it"
        ));
    }
    let image = Image::from_buffer(
        &bytes,
        ImageType::Extension("png"),
        CompressedImageFormats::NONE,
        false,
        ImageSampler::Default,
        RenderAssetUsages::MAIN_WORLD,
    );
    let image = image.map_err(|error| {
        format!(
            "{name} can't be read as a PNG: {error}; save it anew, and see that Bevy is built with its \
             feature `png`"
        )
    })?;
    StampImage::from_image(&image).map_err(|error| format!("{name} can't be a stamp: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, bytes: &[u8]) -> Result<StampImage, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        read_image(&path)
    }

    #[test]
    fn what_is_no_image_is_refused_with_a_sentence_that_names_it() {
        let mut lying = PNG_START.to_vec();
        lying.extend(b"\0\0\0\rIHDR");
        lying.extend([0x7f; 8]);
        lying.extend([8, 0, 0, 0, 0]);
        for (name, bytes) in [
            ("empty.png", &[][..]),
            ("text.png", b"a stamp, honestly"),
            ("cut.png", &PNG_START),
            ("lying.png", &lying),
        ] {
            let error = read(name, bytes).unwrap_err();
            assert!(error.contains(name), "{error}");
        }
        let cut = [&lying[..16], &[0, 0, 0, 16, 0, 0, 0, 16, 8, 0, 0, 0, 0]].concat();
        assert!(read("short.png", &cut).unwrap_err().contains("short.png"));
        assert!(read_image(Path::new("/nowhere/at.png")).is_err());
        assert!(read_image(Path::new("/")).is_err());
    }
}
