//! Detail: ground finer than the stored samples, so that there is something to be seen, and to be
//! stood on, at the player's feet.
//!
//! Stored samples lie a metre or more apart. Between them the ground would be smooth however many
//! triangles it is cut into; detail displacement (Cantlay 2011; Fournier 1982) adds octaves of
//! noise to it, as high as a [rule](DetailRule) says.
//!
//! # Formulas
//! The displacement at lattice point `p`, in metres, added to the stored height:
//!
//! `d(p) = weight · Σ amplitude_o · fade_o · noise_o(p)`
//!
//! * `noise_o` is gradient noise, -1..=1: the corners of a square cell get a direction from a hash
//!   of cell, octave and seed, and what rises in these directions is blended with
//!   `6t⁵ - 15t⁴ + 10t³`, so that noise and slope are both continuous. See [`DetailOctave`].
//! * `amplitude_o` falls off by [`gain`](TerrainDetail::gain) from octave to octave. All of them
//!   add up to [`amplitude_m`](TerrainDetail::amplitude_m) exactly, so that nothing ever rises
//!   above that ([`DetailKernel::bound_m`]). Most ground stays within a third of it, because octaves
//!   seldom agree.
//! * `fade_o` is 1 for octaves that vertices can show and 0 for finer ones, see
//!   [`DetailKernel::fade`].
//! * `weight`, 0..1, is the [rule](DetailKernel::weight), from the stored ground alone.
//!
//! `noise_o` is a function of the lattice point and nothing else, in integers up to the fraction
//! within a cell, which is exact. `weight` and `fade_o` have to be functions of point and view;
//! then displacement can't open a crack, whichever face asks (condition 5 in the design: height is
//! a function of position and view alone).
//!
//! # Density
//! Ground with detail bends more than the stored heights know, so its
//! [density](crate::density) is at least [`DetailKernel::density`]: curvature times spacing, as for
//! stored heights. A wave of amplitude `a` and length `w` bends by `κ = a (2π / w)²` at its crests.
//! The spacing `s` is that of the samples, or a quarter of the wavelength where that is less:
//! octaves finer than the samples are drawn by vertices that stand closer, and taken at the
//! samples' spacing they would turn by more than once around from one to the next. Octaves know
//! nothing of each other, so that their squares add up:
//!
//! `density = min(weight · 2 · √(Σ (a_o (2π / w_o)² · min(s, w_o / 4))²), 1)`
//!
//! with the [scale](crate::density::DensityFilter::scale) of mean curvature, 2, rounded up to whole
//! units. Crests of gradient noise are lower than `a`, so this is rather more than less.

mod kernel;
mod noise;
mod settings;

pub use kernel::{
    DETAIL_EVERYWHERE, DETAIL_HEIGHT, DETAIL_OCTAVES, DETAIL_SLOPE, DetailKernel, DetailOctave,
};
pub use settings::{DetailRule, TerrainDetail, TerrainDetailError};
