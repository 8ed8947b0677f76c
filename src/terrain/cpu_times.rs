//! What the terrains' own systems take of the CPU, for whoever wants to know.

use bevy::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A system, or what systems do together, whose time is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TerrainCpuStage {
    /// The cameras' views are computed ([`TerrainSystems::View`](super::TerrainSystems::View)).
    View,
    /// Tiles are planned, loaded, activated and evicted
    /// ([`TerrainSystems::Stream`](super::TerrainSystems::Stream)), without what reading takes in the
    /// background.
    Stream,
    /// Nodes are selected and culled; in apps that draw.
    Cull,
    /// What changed is told to the render world; in apps that draw.
    Extract,
}

impl TerrainCpuStage {
    /// All of them, in the order of a frame.
    pub const ALL: [Self; 4] = [Self::View, Self::Stream, Self::Cull, Self::Extract];

    /// What it is called.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Stream => "stream",
            Self::Cull => "cull",
            Self::Extract => "extract",
        }
    }
}

#[derive(Debug, Default)]
struct Shared {
    is_measured: AtomicBool,
    nanoseconds: [AtomicU64; TerrainCpuStage::ALL.len()],
}

/// CPU time that the terrains' systems took when they last ran; a resource, of which clones are one.
///
/// Nothing is measured until [`set_measured`](Self::set_measured) asks for it; then it costs two
/// readings of the clock a stage and frame.
#[derive(Resource, Clone, Debug, Default)]
pub struct TerrainCpuTimes(Arc<Shared>);

impl TerrainCpuTimes {
    /// Begins or ends measuring. What was measured before is forgotten when it ends.
    pub fn set_measured(&self, is_measured: bool) {
        self.0.is_measured.store(is_measured, Ordering::Relaxed);
        if !is_measured {
            for stage in &self.0.nanoseconds {
                stage.store(0, Ordering::Relaxed);
            }
        }
    }

    /// Whether times are taken.
    #[must_use]
    pub fn is_measured(&self) -> bool {
        self.0.is_measured.load(Ordering::Relaxed)
    }

    /// What a stage took in the newest frame in which it ran; 0 where nothing is measured.
    #[must_use]
    pub fn of(&self, stage: TerrainCpuStage) -> Duration {
        Duration::from_nanos(self.0.nanoseconds[stage as usize].load(Ordering::Relaxed))
    }

    /// Takes the time from here to the drop of what is returned.
    pub(crate) fn measure(&self, stage: TerrainCpuStage) -> Option<Measuring<'_>> {
        self.is_measured().then(|| Measuring {
            nanoseconds: &self.0.nanoseconds[stage as usize],
            began: Instant::now(),
        })
    }
}

/// A stage that runs.
pub(crate) struct Measuring<'a> {
    nanoseconds: &'a AtomicU64,
    began: Instant,
}

impl Drop for Measuring<'_> {
    fn drop(&mut self) {
        let took = u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.nanoseconds.store(took, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_taken_only_while_they_are_wanted() {
        let times = TerrainCpuTimes::default();
        let same = times.clone();
        drop(times.measure(TerrainCpuStage::Cull));
        assert_eq!(same.of(TerrainCpuStage::Cull), Duration::ZERO);
        same.set_measured(true);
        let measuring = times.measure(TerrainCpuStage::Cull);
        std::thread::sleep(Duration::from_millis(2));
        drop(measuring);
        assert!(same.of(TerrainCpuStage::Cull) >= Duration::from_millis(2));
        assert_eq!(same.of(TerrainCpuStage::View), Duration::ZERO);
        times.set_measured(false);
        assert_eq!(same.of(TerrainCpuStage::Cull), Duration::ZERO);
    }
}
