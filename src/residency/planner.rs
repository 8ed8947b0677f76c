//! Needs of all eyes and terrains, merged and ranked.

use super::needs::{Eye, Level, Survey, Sweep, TileRect, survey};
use super::tile_bits::bit;
use super::{LOOKAHEAD_MAX_S, Need, PlanTerrain, Ranked};
use crate::tile::TileAddress;
use std::ops::Range;

// A key says how pressing a tile is, the least first: its need in the two highest bits, below
// them the level above the root, a distance in 1/1024 tile sizes, or a time.
const CLASS_LOG2: u32 = 30;
const PINNED: u32 = 1 << CLASS_LOG2;
const NOW: u32 = 2 << CLASS_LOG2;
const SOON: u32 = 3 << CLASS_LOG2;
const CLASS_MASK: u32 = SOON;
/// No need at all.
const NONE: u32 = u32::MAX;

/// The look-ahead in units of [`SOON`] keys, as a power of two.
const SOON_LOG2: u32 = 24;
/// What a resident tile's key is lessened by, as a part of it: one over two to this power.
const BONUS_LOG2: u32 = 3;

const PINNED_BUCKETS: u32 = 32;
const NOW_BUCKETS: u32 = 64;
/// Mantissa bits of an `f32` that [`NOW`] buckets leave out.
const NOW_SHIFT: u32 = 16;
/// The bucket's bits of distance 0, which is taken as 1.0 or 1024.
const NOW_FIRST: u32 = 1024_f32.to_bits() >> NOW_SHIFT;
/// One more than the greatest distance takes.
const SOON_BUCKETS: u32 =
    NOW_BUCKETS + ((1_u32 << 31) as f32).to_bits() / (1 << NOW_SHIFT) - NOW_FIRST;
const SOON_SHIFT: u32 = 13;
const BUCKETS: u32 = SOON_BUCKETS + (1 << (SOON_LOG2 - SOON_SHIFT));

/// What a plan says about one eye.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EyeFigures {
    /// Tiles that the eye needs where it is and that can be had, before the capacity cut any.
    pub wanted_now: u32,
    /// Whether the capacity cut any of those.
    pub cut: bool,
    /// How many levels coarser the ground is than the eye may ask for: see
    /// [`levels_short`](super::levels_short).
    pub levels_short: u8,
}

/// What should be resident.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plan {
    ranked: Vec<Ranked>,
    eyes: Vec<EyeFigures>,
    /// Where each terrain's eyes end in `eyes`.
    eye_ends: Vec<usize>,
    candidates: usize,
    is_cut: bool,
}

impl Plan {
    /// The tiles that should be resident, the most pressing first, parents before their children;
    /// at most as many as the capacity.
    #[must_use]
    pub fn ranked(&self) -> &[Ranked] {
        &self.ranked
    }

    /// How many tiles would be ranked if the capacity had no end.
    #[must_use]
    pub fn candidates(&self) -> usize {
        self.candidates
    }

    /// Whether the capacity cut a tile that is needed now, or one that is pinned or a root.
    #[must_use]
    pub fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// The figures of a planned terrain's eyes, in their order; none where there is no such
    /// terrain.
    #[must_use]
    pub fn eyes(&self, terrain: usize) -> &[EyeFigures] {
        let Some(&end) = self.eye_ends.get(terrain) else {
            return &[];
        };
        let before = terrain.checked_sub(1).map(|before| self.eye_ends[before]);
        &self.eyes[before.unwrap_or(0)..end]
    }

    /// The most levels that any eye is short.
    #[must_use]
    pub fn levels_short(&self) -> u8 {
        let short = self.eyes.iter().map(|eye| eye.levels_short);
        short.max().unwrap_or(0)
    }

    fn clear(&mut self) {
        self.ranked.clear();
        self.eyes.clear();
        self.eye_ends.clear();
    }
}

/// Ranks tiles by need; see the [module](super) for how and in which order.
///
/// Keeps nothing from one plan to the next but memory: some 16 bytes for each tile that the
/// largest plan had to choose from, and 20 for each ranked.
#[derive(Clone, Debug, Default)]
pub struct Planner {
    plan: Plan,
    eyes: Vec<Eye>,
    pool: Pool,
    rows: Rows,
}

impl Planner {
    /// Ranks the tiles of all `terrains` that are needed now or will be within `lookahead_s`
    /// seconds (none ahead where that is 0, less, or no number), and keeps the best `capacity`.
    pub fn plan(&mut self, terrains: &[PlanTerrain], capacity: usize, lookahead_s: f32) -> &Plan {
        let horizon_s = if lookahead_s > 0.0 {
            f64::from(lookahead_s.min(LOOKAHEAD_MAX_S))
        } else {
            0.0
        };
        self.plan.clear();
        self.eyes.clear();
        self.pool.clear();
        for terrain in terrains {
            for path in terrain.eyes {
                let eye = Eye::new(terrain.lattice, path);
                let Survey {
                    wanted,
                    levels_short,
                } = survey(terrain.lattice, terrain.available, terrain.resident, &eye);
                self.eyes.push(eye);
                self.plan.eyes.push(EyeFigures {
                    wanted_now: wanted,
                    cut: false,
                    levels_short,
                });
            }
            self.plan.eye_ends.push(self.eyes.len());
        }
        let levels = terrains.iter().map(|terrain| terrain.available.levels());
        for depth in 0..levels.max().unwrap_or(0) {
            let mut first = 0;
            for (number, terrain) in (0..).zip(terrains) {
                let eyes = &self.eyes[first..first + terrain.eyes.len()];
                first += terrain.eyes.len();
                if let Some(level) = terrain.available.levels().checked_sub(depth + 1) {
                    let job = Job {
                        terrain,
                        number,
                        depth,
                        horizon_s,
                        level: Level::new(terrain.lattice, level, terrain.available.bits()),
                    };
                    self.rows.collect(&job, eyes, &mut self.pool);
                }
            }
        }
        self.rank(terrains, capacity);
        &self.plan
    }

    /// The latest plan; an empty one before the first.
    #[must_use]
    pub fn latest(&self) -> &Plan {
        &self.plan
    }

    /// Sorts the candidates by bucket; within one, they stay in the order they were found in.
    fn rank(&mut self, terrains: &[PlanTerrain], capacity: usize) {
        let Self {
            plan, pool, eyes, ..
        } = self;
        let candidates = &pool.candidates[..pool.count];
        let mut place = 0;
        let mut pressing = 0;
        for (bucket, count) in (0..).zip(&mut pool.buckets) {
            if bucket == SOON_BUCKETS {
                pressing = place;
            }
            let next = place + *count;
            *count = place;
            place = next;
        }
        let ranked = pool.count.min(capacity);
        plan.candidates = pool.count;
        plan.is_cut = pressing as usize > capacity;
        plan.ranked.resize(ranked, Ranked::default());
        for candidate in candidates {
            let place = &mut pool.buckets[usize::from(candidate.bucket)];
            let at = *place as usize;
            *place += 1;
            if let Some(ranked) = plan.ranked.get_mut(at) {
                *ranked = candidate.ranked();
            } else if u32::from(candidate.bucket) < SOON_BUCKETS {
                let number = candidate.terrain as usize;
                let first = number.checked_sub(1).map_or(0, |at| plan.eye_ends[at]);
                let range = first..plan.eye_ends[number];
                let figures = &mut plan.eyes[range.clone()];
                if figures.iter().all(|eye| eye.cut) {
                    continue;
                }
                let PlanTerrain {
                    lattice, available, ..
                } = &terrains[number];
                let level = Level::new(lattice, candidate.level, available.bits());
                for (figures, eye) in figures.iter_mut().zip(&eyes[range]) {
                    figures.cut |= eye.now(&level).contains(candidate.x, candidate.z);
                }
            }
        }
    }
}

/// A tile that may be ranked.
#[derive(Clone, Copy, Debug, Default)]
struct Candidate {
    x: u32,
    z: u32,
    terrain: u32,
    bucket: u16,
    level: u8,
}

impl Candidate {
    fn ranked(&self) -> Ranked {
        let need = match u32::from(self.bucket) {
            0..PINNED_BUCKETS => Need::Root,
            PINNED_BUCKETS..NOW_BUCKETS => Need::Pinned,
            NOW_BUCKETS..SOON_BUCKETS => Need::Now,
            SOON_BUCKETS.. => Need::Soon,
        };
        Ranked {
            terrain: self.terrain,
            address: TileAddress::new(self.level, self.x, self.z),
            need,
        }
    }
}

/// The candidates found so far, and how many there are of each bucket.
#[derive(Clone, Debug, Default)]
struct Pool {
    /// Only grows; the first `count` count.
    candidates: Vec<Candidate>,
    count: usize,
    buckets: Vec<u32>,
}

impl Pool {
    fn clear(&mut self) {
        self.count = 0;
        self.buckets.clear();
        self.buckets.resize(BUCKETS as usize, 0);
    }
}

/// A level of a terrain whose candidates are being found.
#[derive(Clone, Copy, Debug)]
struct Job<'a> {
    terrain: &'a PlanTerrain<'a>,
    number: u32,
    /// Levels below the root.
    depth: u8,
    horizon_s: f64,
    level: Level,
}

/// What an eye needs of a level.
#[derive(Clone, Debug)]
struct EyeLevel {
    eye: Eye,
    now: TileRect,
    sweep: Option<Sweep>,
    floor: u32,
    /// Where the distances of the needed columns begin in [`Rows::distances`].
    distances: usize,
    /// Where the times of the swept columns begin in [`Rows::times_s`].
    times: usize,
}

/// Columns of a row that are needed for the same reason.
#[derive(Clone, Debug)]
struct Span {
    columns: Range<u32>,
    source: Source,
}

#[derive(Clone, Copy, Debug)]
enum Source {
    /// Root or pinned: the same key everywhere.
    Key(u32),
    /// An eye needs it, at this distance at least.
    Now { eye: usize, distance: u32 },
    /// An eye will need it, between these times at most.
    Soon { eye: usize, times_s: [f64; 2] },
}

/// Finds a level's candidates row by row.
#[derive(Clone, Debug, Default)]
struct Rows {
    eyes: Vec<EyeLevel>,
    pins: Vec<TileRect>,
    /// Distances of columns from eyes.
    distances: Vec<u32>,
    /// When columns come into eyes' reach and leave it.
    times_s: Vec<[f64; 2]>,
    spans: Vec<Span>,
    /// Keys of a row's tiles, valid where a span is.
    keys: Vec<u32>,
}

impl Rows {
    fn collect(&mut self, job: &Job, eyes: &[Eye], pool: &mut Pool) {
        let level = &job.level;
        let [columns, rows] = level.tiles;
        if self.keys.len() < columns as usize {
            self.keys.resize(columns as usize, NONE);
        }
        if job.depth < job.terrain.root_levels.max(1) {
            let source = Source::Key(u32::from(job.depth));
            for z in 0..rows {
                self.spans.clear();
                self.spans.push(Span {
                    columns: 0..columns,
                    source,
                });
                self.finish_row(job, z, pool);
            }
            return;
        }
        let needed = self.prepare(job, eyes);
        for z in needed {
            self.spans.clear();
            self.find_spans(job, z);
            self.finish_row(job, z, pool);
        }
    }

    /// Finds what holds for all rows: rectangles, distances and times of columns. Returns the
    /// rows in which anything is needed.
    fn prepare(&mut self, job: &Job, eyes: &[Eye]) -> Range<u32> {
        let level = &job.level;
        self.eyes.clear();
        self.pins.clear();
        self.distances.clear();
        self.times_s.clear();
        let (mut first, mut end) = (u32::MAX, 0);
        let mut widen = |rect: &TileRect| {
            if !rect.is_empty() {
                first = first.min(rect.z.start);
                end = end.max(rect.z.end);
            }
        };
        for eye in eyes {
            let (distances, times) = (self.distances.len(), self.times_s.len());
            let now = eye.now(level);
            if !now.is_empty() {
                let columns = now.x.clone();
                self.distances
                    .extend(columns.map(|x| eye.distance(level, 0, x)));
            }
            widen(&now);
            let sweep = eye.soon(level, job.horizon_s);
            if let Some(sweep) = &sweep {
                let columns = sweep.rect.x.clone();
                self.times_s
                    .extend(columns.map(|x| eye.times_s(level, 0, x, sweep)));
                widen(&sweep.rect);
            }
            if now.is_empty() && sweep.is_none() {
                continue;
            }
            self.eyes.push(EyeLevel {
                eye: *eye,
                now,
                sweep,
                floor: eye.floor_distance(level),
                distances,
                times,
            });
        }
        for pin in job.terrain.pins {
            let rect = TileRect::pinned(level, pin);
            if !rect.is_empty() {
                widen(&rect);
                self.pins.push(rect);
            }
        }
        first..end
    }

    /// Finds the columns of a row that are needed.
    fn find_spans(&mut self, job: &Job, z: u32) {
        let spans = &mut self.spans;
        for rect in &self.pins {
            if rect.z.contains(&z) {
                spans.push(Span {
                    columns: rect.x.clone(),
                    source: Source::Key(PINNED | u32::from(job.depth)),
                });
            }
        }
        for (at, eye) in self.eyes.iter().enumerate() {
            let mut now = 0..0;
            if eye.now.z.contains(&z) && !eye.now.x.is_empty() {
                now = eye.now.x.clone();
                let distance = eye.eye.distance(&job.level, 1, z).max(eye.floor);
                spans.push(Span {
                    columns: now.clone(),
                    source: Source::Now { eye: at, distance },
                });
            }
            let Some(sweep) = &eye.sweep else {
                continue;
            };
            if let Some((times_s, columns)) = eye.eye.sweep_row(&job.level, z, sweep) {
                let source = Source::Soon { eye: at, times_s };
                let beside = if now.is_empty() {
                    [columns, 0..0]
                } else {
                    [
                        columns.start..columns.end.min(now.start),
                        columns.start.max(now.end)..columns.end,
                    ]
                };
                for columns in beside {
                    if !columns.is_empty() {
                        spans.push(Span { columns, source });
                    }
                }
            }
        }
    }

    /// Finds the keys of a row's tiles, the most pressing of all spans, and puts the tiles that
    /// can be had in the pool.
    fn finish_row(&mut self, job: &Job, z: u32, pool: &mut Pool) {
        if let [span] = &self.spans[..]
            && let Source::Key(key) = span.source
        {
            let columns = span.columns.clone();
            self.keys[columns.start as usize..columns.end as usize].fill(key);
            self.emit(job, z, columns, pool);
            return;
        }
        for Span { columns, .. } in &self.spans {
            self.keys[columns.start as usize..columns.end as usize].fill(NONE);
        }
        for Span { columns, source } in &self.spans {
            let keys = &mut self.keys[columns.start as usize..columns.end as usize];
            match *source {
                Source::Key(own) => {
                    for key in keys {
                        *key = own.min(*key);
                    }
                }
                Source::Now { eye, distance } => {
                    let distances = &self.distances[self.eyes[eye].distances..];
                    for (key, &column) in keys.iter_mut().zip(distances) {
                        *key = (NOW | column.max(distance)).min(*key);
                    }
                }
                Source::Soon { eye, times_s } => {
                    let eye = &self.eyes[eye];
                    let Some(sweep) = &eye.sweep else {
                        continue;
                    };
                    let first = eye.times + (columns.start - sweep.rect.x.start) as usize;
                    let per_s = f64::from(1_u32 << SOON_LOG2) / job.horizon_s;
                    for (key, &[from_s, until_s]) in keys.iter_mut().zip(&self.times_s[first..]) {
                        let from_s = from_s.max(times_s[0]);
                        if from_s < until_s.min(times_s[1]) {
                            #[expect(
                                clippy::cast_possible_truncation,
                                clippy::cast_sign_loss,
                                reason = "from 0 to a time before the horizon"
                            )]
                            let time = ((from_s * per_s) as i32 as u32).min((1 << SOON_LOG2) - 1);
                            *key = (SOON | time).min(*key);
                        }
                    }
                }
            }
        }
        self.spans.sort_unstable_by_key(|span| span.columns.start);
        let mut at = 0;
        while let Some(span) = self.spans.get(at) {
            let mut columns = span.columns.clone();
            at += 1;
            while let Some(next) = self.spans.get(at)
                && next.columns.start <= columns.end
            {
                columns.end = columns.end.max(next.columns.end);
                at += 1;
            }
            self.emit(job, z, columns, pool);
        }
    }

    /// Puts the tiles of some columns, whose keys are known, in the pool.
    fn emit(&self, job: &Job, z: u32, columns: Range<u32>, pool: &mut Pool) {
        let level = job.level.level;
        let available = job.terrain.available.bits().row(level, z);
        let resident = job.terrain.resident.bits().row(level, z);
        let room = pool.count + columns.len();
        if pool.candidates.len() < room {
            pool.candidates.resize(room, Candidate::default());
        }
        let keys = &self.keys[columns.start as usize..columns.end as usize];
        for (x, &key) in columns.zip(keys) {
            if key == NONE || !bit(available, x) {
                continue;
            }
            let bucket = bucket(key, bit(resident, x));
            pool.buckets[bucket as usize] += 1;
            pool.candidates[pool.count] = Candidate {
                x,
                z,
                terrain: job.number,
                bucket: bucket as u16,
                level,
            };
            pool.count += 1;
        }
    }
}

/// The place of a key among the buckets. Keeps order among tiles that are all resident or all not,
/// and puts resident ones no later.
fn bucket(key: u32, is_resident: bool) -> u32 {
    let value = key & !CLASS_MASK;
    let bonus = if is_resident { value >> BONUS_LOG2 } else { 0 };
    match key & CLASS_MASK {
        NOW => {
            let from_1024 = (value - bonus + 1024).cast_signed() as f32;
            NOW_BUCKETS + (from_1024.to_bits() >> NOW_SHIFT) - NOW_FIRST
        }
        SOON => SOON_BUCKETS + ((value - bonus) >> SOON_SHIFT),
        PINNED => PINNED_BUCKETS + value,
        _ => value,
    }
}
