//! The figures of a view and a terrain, and the sums over all, as text.

use crate::debug::TerrainChoice;
use crate::edit::TerrainEdits;
use crate::edit::mask::TerrainMask;
use crate::render::{TerrainGpuMemory, TerrainStatistics, TerrainViewStatistics};
use crate::stream::{TILE_BYTES, TerrainPin, TerrainPinProgress, TerrainState, TerrainStreamer};
use bevy::prelude::*;
use std::fmt::Write as _;

/// A line of a table.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Row {
    pub(super) name: &'static str,
    pub(super) hover: &'static str,
    /// Of the chosen view or terrain.
    pub(super) chosen: String,
    /// Of all of them.
    pub(super) all: String,
}

/// Groups of three digits.
pub(super) fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

pub(super) fn mib(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}

fn percent(part: u64, whole: u64) -> String {
    if whole == 0 {
        return String::new();
    }
    format!(" ({:.0} %)", 100.0 * part as f64 / whole as f64)
}

/// Sums over views.
#[derive(Clone, Copy, Default)]
struct ViewSums {
    views: u64,
    faces: u64,
    culled: u64,
    vertices: u64,
    triangles: u64,
    wanted_vertices: u64,
    wanted_triangles: u64,
    room: u64,
    overflow: u32,
    width_scale: f32,
    /// Vertices and triangles; of those views that have them counted.
    saved: Option<[u64; 2]>,
    /// What those would have without density.
    plain: [u64; 2],
    clamped: u64,
    edges: u64,
    bytes: u64,
}

impl ViewSums {
    fn add(&mut self, view: &TerrainViewStatistics) {
        self.views += 1;
        self.faces += u64::from(view.counters.faces);
        self.culled += u64::from(view.counters.culled_faces);
        self.vertices += u64::from(view.vertices);
        self.triangles += u64::from(view.triangles);
        self.wanted_vertices += u64::from(view.wanted_vertices);
        self.wanted_triangles += u64::from(view.wanted_triangles);
        self.room += u64::from(view.room_vertices);
        self.overflow = self.overflow.max(view.overflow);
        self.width_scale = self.width_scale.max(view.width_scale);
        self.clamped += u64::from(view.counters.clamped_edges);
        self.edges += u64::from(view.counters.edges);
        self.bytes += view.gpu_bytes;
        if let Some(saved) = view.saved() {
            let [vertices, triangles] = self.saved.get_or_insert_default();
            *vertices += u64::from(saved.vertices);
            *triangles += u64::from(saved.triangles);
            self.plain[0] += u64::from(view.counters.plain_vertices);
            self.plain[1] += u64::from(view.counters.plain_triangles);
        }
    }
}

/// The figures of meshes: of the chosen camera's view of the chosen terrain, and of all.
pub(super) fn views(
    chosen: TerrainChoice,
    cameras: impl Iterator<Item = (Entity, impl std::ops::Deref<Target = TerrainStatistics>)>,
) -> Vec<Row> {
    let [mut own, mut all] = [ViewSums::default(); 2];
    for (camera, statistics) in cameras {
        for (terrain, view) in &statistics.terrains {
            all.add(view);
            if Some(camera) == chosen.camera && Some(*terrain) == chosen.terrain {
                own.add(view);
            }
        }
    }
    let row = |name, hover, text: &dyn Fn(&ViewSums) -> String| Row {
        name,
        hover,
        chosen: if own.views == 0 {
            "–".to_owned()
        } else {
            text(&own)
        },
        all: text(&all),
    };
    let saved = |which: usize| {
        move |sums: &ViewSums| match sums.saved {
            None => "not counted".to_owned(),
            Some(saved) => grouped(saved[which]) + &percent(saved[which], sums.plain[which]),
        }
    };
    vec![
        row(
            "Faces drawn",
            "Control faces that somebody sees. Each costs GPU time in the classify pass, however \
             little it is cut.",
            &|sums| grouped(sums.faces),
        ),
        row(
            "Faces culled",
            "Faces of the view's nodes that neither the camera nor a light that casts shadows for it \
             sees. They are left out.",
            &|sums| grouped(sums.culled),
        ),
        row("Vertices", "Vertices drawn in this frame.", &|sums| {
            grouped(sums.vertices)
        }),
        row(
            "Triangles",
            "Triangles drawn in this frame, in each pass that draws the terrain.",
            &|sums| grouped(sums.triangles),
        ),
        row(
            "Saved vertices",
            "Vertices that the density map spares: what the same view would have with a density \
             strength of 0, less what it has; of what it would have then. Counted on the GPU. 0 under \
             the policy of screen errors, which asks no densities.",
            &saved(0),
        ),
        row(
            "Saved triangles",
            "Triangles that the density map spares. Little saved: the ground is rough everywhere, or \
             the map says so; bake with a filter or a factor that tells plain ground apart.",
            &saved(1),
        ),
        row(
            "Wanted vertices",
            "Vertices that the settings ask for, were there room enough.",
            &|sums| grouped(sums.wanted_vertices),
        ),
        row(
            "Wanted triangles",
            "Triangles that the settings ask for, were there room enough.",
            &|sums| grouped(sums.wanted_triangles),
        ),
        row(
            "Room",
            "Vertices that the buffers hold. They grow to a quarter more than was wanted, up to \
             max_vertices.",
            &|sums| grouped(sums.room) + &percent(sums.vertices, sums.room),
        ),
        row(
            "Overflow",
            "All factors were divided by this, because the buffers were too small in this frame. \
             Passes after a frame or two, as buffers grow; where it stays, raise max_vertices.",
            &|sums| format!("÷ {}", 1_u64 << sums.overflow.min(63)),
        ),
        row(
            "Width scale",
            "Triangles are so many times wider than wanted, because the view wants more than \
             max_vertices. Above 1: raise max_vertices or the triangle width.",
            &|sums| format!("× {:.2}", sums.width_scale.max(1.0)),
        ),
        row(
            "Clamped edges",
            "Edges that would be cut more finely but for max_factor. Many: triangles are larger than \
             wanted; use more faces a side.",
            &|sums| grouped(sums.clamped) + &percent(sums.clamped, sums.edges),
        ),
        row(
            "Mesh memory",
            "GPU memory of nodes, factors, vertices and indices, free room included.",
            &|sums| mib(sums.bytes),
        ),
    ]
}

/// Tiles by level, the finest first.
pub(super) type LevelCounts = [u32; crate::lattice::MAX_LEVELS];

/// What a terrain holds, counted anew only where it has changed.
#[derive(Debug, Default)]
pub(super) struct LevelsCounted {
    known: Option<(u64, u64)>,
    counts: LevelCounts,
}

impl LevelsCounted {
    fn of(&mut self, state: &TerrainState) -> &LevelCounts {
        let now = (state.instance(), state.pages_version());
        if self.known != Some(now) {
            self.known = Some(now);
            self.counts = LevelCounts::default();
            for tile in state.residents() {
                if let Some(count) = self.counts.get_mut(usize::from(tile.level)) {
                    *count += 1;
                }
            }
        }
        &self.counts
    }
}

/// Tiles that get a page, a second.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LoadRate {
    since: Option<(std::time::Instant, u64)>,
    tiles_a_s: Option<f64>,
}

impl LoadRate {
    /// Over what time the rate is taken.
    const SPAN_S: f64 = 1.0;

    pub(super) fn update(&mut self, tiles: u64) {
        let now = std::time::Instant::now();
        let (began, before) = *self.since.get_or_insert((now, tiles));
        let passed_s = now.duration_since(began).as_secs_f64();
        if passed_s >= Self::SPAN_S {
            self.tiles_a_s = Some(tiles.saturating_sub(before) as f64 / passed_s);
            self.since = Some((now, tiles));
        }
    }

    fn text(self) -> String {
        let Some(tiles_a_s) = self.tiles_a_s else {
            return "–".to_owned();
        };
        let mib_a_s = tiles_a_s * TILE_BYTES as f64 / f64::from(1 << 20);
        format!("{tiles_a_s:.0} tiles/s, {mib_a_s:.1} MiB/s")
    }
}

/// What is asked of a terrain.
pub(super) type TerrainItem<'a> = (
    Entity,
    &'a TerrainState,
    Option<&'a TerrainEdits>,
    Option<&'a TerrainMask>,
);

/// Sums over terrains.
#[derive(Clone, Copy, Default)]
struct TerrainSums {
    terrains: u64,
    resident: u64,
    loading: u64,
    failed: u64,
    wanted: u64,
    levels_short: u8,
    is_short_of_pages: bool,
    edits: u64,
    records: u64,
    snapshots: u64,
    mask_pages: u64,
    mask_bytes: u64,
    mask_refused: u64,
}

impl TerrainSums {
    fn add(&mut self, (_, state, edits, mask): TerrainItem) {
        self.terrains += 1;
        self.resident += state.resident_count() as u64;
        self.loading += state.loading_count() as u64;
        self.failed += state.failed_count() as u64;
        self.wanted += state.wanted_count() as u64;
        self.levels_short = self.levels_short.max(state.levels_short());
        self.is_short_of_pages |= state.is_short_of_pages();
        if let Some(log) = edits.and_then(TerrainEdits::log) {
            self.edits += log.active_count() as u64;
            self.records += log.len() as u64;
            self.snapshots += log.snapshot_count() as u64;
        }
        if let Some(mask) = mask.map(TerrainMask::mask) {
            self.mask_pages += mask.page_count() as u64;
            self.mask_bytes += mask.bytes() as u64;
            self.mask_refused += mask.refused();
        }
    }
}

/// The figures of streaming and of edits; their text is made where it is shown.
pub(super) struct TerrainFigures {
    own: TerrainSums,
    all: TerrainSums,
    /// Pins, and how many of them are ready.
    own_pins: [u64; 2],
    all_pins: [u64; 2],
    /// How many tiles of each level of the chosen terrain are resident.
    pub(super) by_level: String,
}

/// The figures of the chosen terrain, and of all.
pub(super) fn terrains<'a>(
    chosen: Option<Entity>,
    terrains: impl Iterator<Item = TerrainItem<'a>>,
    pins: impl Iterator<Item = (&'a TerrainPin, &'a TerrainPinProgress)>,
    levels: &mut LevelsCounted,
) -> TerrainFigures {
    let [mut own, mut all] = [TerrainSums::default(); 2];
    let mut by_level = String::new();
    for terrain in terrains {
        all.add(terrain);
        if Some(terrain.0) == chosen {
            own.add(terrain);
            let used = levels.of(terrain.1).iter().zip(0_u32..);
            for (count, level) in used.filter(|(count, _)| **count > 0) {
                let separator = if by_level.is_empty() { "" } else { "  " };
                let _ = write!(by_level, "{separator}L{level}: {count}");
            }
        }
    }
    let [mut own_pins, mut all_pins] = [[0_u64; 2]; 2];
    for (pin, progress) in pins {
        let counts = [1, u64::from(progress.is_ready())];
        let add = |sums: &mut [u64; 2]| sums.iter_mut().zip(counts).for_each(|(s, n)| *s += n);
        add(&mut all_pins);
        if Some(pin.terrain) == chosen {
            add(&mut own_pins);
        }
    }
    TerrainFigures {
        own,
        all,
        own_pins,
        all_pins,
        by_level,
    }
}

impl TerrainFigures {
    fn row(
        &self,
        name: &'static str,
        hover: &'static str,
        text: &dyn Fn(&TerrainSums) -> String,
    ) -> Row {
        Row {
            name,
            hover,
            chosen: if self.own.terrains == 0 {
                "–".to_owned()
            } else {
                text(&self.own)
            },
            all: text(&self.all),
        }
    }

    pub(super) fn streaming(&self) -> Vec<Row> {
        let row = |name, hover, text: &dyn Fn(&TerrainSums) -> String| self.row(name, hover, text);
        let pins_text = |[count, ready]: [u64; 2]| format!("{count}, {ready} ready");
        vec![
            row(
                "Tiles resident",
                "Tiles that have a page, at all levels.",
                &|sums| grouped(sums.resident),
            ),
            row(
                "Tiles wanted",
                "Tiles that the views and pins want, resident or not, as far as the memory goes.",
                &|sums| grouped(sums.wanted),
            ),
            row(
                "Tiles loading",
                "Tiles that were asked for and have no page yet. Never 0 while an eye flies; where it \
             doesn't fall when the eye rests, the source is slow.",
                &|sums| grouped(sums.loading),
            ),
            row(
                "Tiles failed",
                "Tiles that are missing or corrupt; their parents' shape stands in. The map tells which, \
             and why.",
                &|sums| grouped(sums.failed),
            ),
            row(
                "Levels short",
                "How many levels coarser than asked for the ground is, where it is worst. Above 0 for \
             long: the source is slow, tiles have failed, or pages are too few.",
                &|sums| {
                    let why = if sums.is_short_of_pages {
                        ", pages are short"
                    } else {
                        ""
                    };
                    format!("{}{why}", sums.levels_short)
                },
            ),
            Row {
                name: "Pins",
                hover: "Regions that are kept resident, and how many of them are there in full.",
                chosen: pins_text(self.own_pins),
                all: pins_text(self.all_pins),
            },
        ]
    }

    pub(super) fn edits(&self) -> Vec<Row> {
        let row = |name, hover, text: &dyn Fn(&TerrainSums) -> String| self.row(name, hover, text);
        vec![
            row(
                "Edits",
                "Edits that count, those taken back left out.",
                &|sums| grouped(sums.edits),
            ),
            row(
                "Records",
                "Records in the log: edits, undos and redos. What a save holds and a diff sends.",
                &|sums| grouped(sums.records),
            ),
            row(
                "Snapshots",
                "Tiles that are kept with their edits, so that few edits are replayed when they come back.",
                &|sums| grouped(sums.snapshots),
            ),
            row(
                "Mask pages",
                "Pages of the destruction mask that hold something. Refused ones didn't fit: raise \
             MaskSettings::max_bytes.",
                &|sums| {
                    let refused = if sums.mask_refused > 0 {
                        format!(", {} refused", grouped(sums.mask_refused))
                    } else {
                        String::new()
                    };
                    grouped(sums.mask_pages) + &refused
                },
            ),
            row(
                "Mask memory",
                "Main memory of the destruction mask; the GPU's copy is in its tables.",
                &|sums| mib(sums.mask_bytes),
            ),
        ]
    }
}

/// The figures that all terrains and cameras share.
pub(super) fn memory(
    streamer: Option<&TerrainStreamer>,
    memory: Option<&TerrainGpuMemory>,
    rate: LoadRate,
) -> Vec<Row> {
    let row = |name, hover, all: String| Row {
        name,
        hover,
        chosen: String::new(),
        all,
    };
    let mut rows = Vec::new();
    if let Some(streamer) = streamer {
        let (used, pages) = (streamer.pages_used(), streamer.pages());
        rows.push(row(
            "Pages used",
            "Pages in use, of those that TerrainStreaming::page_bytes allows. All of them in use is \
             fine, as long as no levels are short.",
            format!(
                "{} of {}{}",
                grouped(used.into()),
                grouped(pages.into()),
                percent(used.into(), pages.into())
            ),
        ));
        rows.push(row(
            "Arriving",
            "Tiles that got a page in the last second, and their bytes once they were read (packed \
             files are smaller).",
            rate.text(),
        ));
        let held = streamer.tiles_held() as u64;
        rows.push(row(
            "Tiles held",
            "Tiles in main memory: those with a page, those on their way, and those that are kept for \
             when they are wanted again. TerrainStreaming::tile_bytes bounds them.",
            format!("{}, {}", grouped(held), mib(held * TILE_BYTES)),
        ));
    }
    if let Some(memory) = memory {
        rows.push(row(
            "Page memory",
            "GPU memory of all pages' textures, free pages included.",
            mib(memory.pages_bytes),
        ));
        rows.push(row(
            "Table memory",
            "GPU memory of page tables, residency fields and destruction masks.",
            mib(memory.tables_bytes),
        ));
        rows.push(row(
            "GPU memory",
            "Pages, tables and all views' meshes together.",
            mib(memory.total_bytes()),
        ));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped_by_three_digits() {
        let grouped: Vec<_> = [0, 999, 1000, 123_456, 1_234_567].map(grouped).into();
        assert_eq!(grouped, ["0", "999", "1,000", "123,456", "1,234,567"]);
    }
}
