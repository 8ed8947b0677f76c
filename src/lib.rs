//! Terrain for [Bevy] games: height maps baked into tiles, tiles streamed around the cameras, and
//! compute passes that cut the ground into triangles, finely near the eye and coarsely far away,
//! without a crack in between. Bevy's own renderer lights it.
//!
//! # Quick start
//! Bake a height map with the tool that comes with this crate,
//!
//! ```sh
//! cargo install bevy_tessera --no-default-features --features cli   # or --path, in a clone
//! tessera bake alps.tif --out assets/terrains/alps
//! ```
//!
//! then spawn a [`Terrain`](terrain::Terrain) and a camera with a
//! [`TerrainCamera`](terrain::TerrainCamera):
//!
#![cfg_attr(feature = "render", doc = "```no_run")]
#![cfg_attr(not(feature = "render"), doc = "```ignore")]
//! use bevy::prelude::*;
//! use bevy_tessera::TerrainPlugins;
//! use bevy_tessera::terrain::{Terrain, TerrainCamera};
//!
//! fn main() -> AppExit {
//!     App::new().add_plugins((DefaultPlugins, TerrainPlugins)).add_systems(Startup, setup).run()
//! }
//!
//! fn setup(mut commands: Commands, assets: Res<AssetServer>) {
//!     commands.spawn(Terrain::new(assets.load("terrains/alps/terrain.ron")));
//!     let eye = Transform::from_xyz(2000.0, 1500.0, 2000.0);
//!     commands.spawn((Camera3d::default(), TerrainCamera::default(), eye));
//!     commands.spawn((DirectionalLight::default(), eye.looking_at(Vec3::ZERO, Vec3::Y)));
//! }
//! ```
//!
//! # Guides
//! In the folder `docs/guides` of the repository and of the package:
//!
//! | guide | for |
//! |---|---|
//! | [bring-your-height-map.md] | baking a file of heights, and seeing it |
//! | [tune-for-your-gpu.md] | what costs what, and which knob to turn first |
//! | [destroy-things.md] | craters, undo, saves, bodies that fall in |
//! | [run-a-server.md] | ground without a GPU, and craters that all share |
//! | [look-inside.md] | panel, overlays, held eye, comparison, lines, remote control |
//! | [how-it-works.md] | lattice, morph, edge factors, density, streaming, edits |
//! | [limits.md] | what it does not do |
//!
//! [bring-your-height-map.md]: https://docs.rs/crate/bevy_tessera/latest/source/docs/guides/bring-your-height-map.md
//! [tune-for-your-gpu.md]: https://docs.rs/crate/bevy_tessera/latest/source/docs/guides/tune-for-your-gpu.md
//! [destroy-things.md]: https://docs.rs/crate/bevy_tessera/latest/source/docs/guides/destroy-things.md
//! [run-a-server.md]: https://docs.rs/crate/bevy_tessera/latest/source/docs/guides/run-a-server.md
//! [look-inside.md]: https://docs.rs/crate/bevy_tessera/latest/source/docs/guides/look-inside.md
//! [how-it-works.md]: https://docs.rs/crate/bevy_tessera/latest/source/docs/guides/how-it-works.md
//! [limits.md]: https://docs.rs/crate/bevy_tessera/latest/source/docs/guides/limits.md
//!
//! # Table of contents
//! A feature in parentheses adds to a module that is there without it.
//!
//! | module | what it holds | feature |
//! |---|---|---|
//! | [`terrain`] | the component and its settings, what opts a camera in, events, the manifest | |
//! | [`tile`] | tile addresses, heights, densities, error bounds, the index, their file format | |
//! | [`archive`] | a whole terrain in one file, on a disk or behind a web server | `archive`, (`http`) |
//! | [`bake`] | height maps to terrains; readers of file formats in `bake::import`, terrains made of nothing in `bake::generate` | (`import`, `generate`) |
//! | [`density`] | curvature filters, and densities from heights | |
//! | [`detail`] | displacement finer than the samples: noise that follows a rule | |
//! | [`edit`] | craters and other changes of the ground, their log, saves and scorch; with `ecs` as triggers | |
//! | [`error_bound`] | bounds on the error that any triangles leave, from heights | |
//! | [`output`] | why a picture or a mesh can't be written at a path | |
//! | [`lattice`] | the integer grid, level of detail, morph, selection, the residency field | |
//! | [`residency`] | what should be resident: all terrains' tiles ranked by need | |
//! | [`tessellate`] | edge factors, partitioning, the CPU twin of the compute passes | |
//! | [`mesh_export`] | a view's mesh as a Wavefront OBJ or binary glTF file | |
//! | `source` | archives, and folders and archives behind web servers, as asset sources | `ecs` with `archive`, (`http`) |
//! | [`query`] | the ground's height, normal and slope, rays at it, and what is under a pointer | (`ecs`, `picking`) |
//! | [`stream`] | which tiles are resident, and the entities that stand for them | `ecs` |
//! | `physics` | colliders for Avian, near bodies and in pinned regions | `avian` |
//! | [`view`] | what each camera's level of detail follows from; with `render` the [held eye](view::TerrainEye) | `ecs` |
//! | [`render`] | culling, compute passes, draws, [materials](render::TerrainMaterial), [overlays](render::TerrainOverlays), [comparison](render::TerrainComparison), [statistics](render::TerrainStatistics) | `render` |
//! | `debug` | the panel: settings, statistics, a map, brushes | `egui` |
//! | `gizmos` | lines: bounds of tiles, rectangles of edits, a held eye's view | `gizmos` |
//! | `remote` | figures and settings over the Bevy Remote Protocol | `remote` |
//!
//! [`TerrainPlugins`] holds it all. Systems that a game may order its own against are in
//! [`TerrainSystems`](terrain::TerrainSystems),
//! [`TerrainRenderSystems`](render::TerrainRenderSystems) and
//! [`TerrainPass`](render::TerrainPass).
//!
//! # Units
//! Metres, with y up. The terrain's first sample lies at its entity's transform; samples run along
//! local x and z. Names say their unit (`_m`, `_px`, `_s`). Levels count up from the finest tiles
//! at 0; each has half the samples a side of the one below it.
//!
//! # Cargo features
//! | feature | adds | default |
//! |---|---|---|
//! | `render` | drawing; implies `ecs` | yes |
//! | `ecs` | terrains as entities and assets, without a renderer | |
//! | `import` | readers of PNG, TIFF, OpenEXR, SRTM and raw height maps | |
//! | `generate` | terrains made of nothing: fractal noise, diamond-square | |
//! | `archive` | terrains in one file: packed tiles in a PMTiles archive | yes |
//! | `avian` | colliders for Avian, near bodies and in pinned regions; implies `ecs` | |
//! | `http` | terrains behind a web server, read by ranges; implies `archive`, needs a C compiler | |
//! | `picking` | terrains under pointers, through Bevy's picking; implies `render` | |
//! | `egui` | the panel, through `bevy_egui`; implies `gizmos` and `picking` | |
//! | `gizmos` | lines over terrains, through Bevy's gizmos; implies `render` | |
//! | `remote` | figures and settings over the Bevy Remote Protocol; implies `ecs` | |
//! | `cli` | the tool `tessera`; implies `import`, `generate` and `archive` | |
//! | `examples` | what the examples need of Bevy: a window, a fly camera, pictures | |
//!
//! With none of them the core is left, which depends on no part of Bevy.
//!
//! # What it does not do
//! The ground is a height field: it has no overhangs, no caves and no holes. Materials are opaque and bind
//! no textures of their own. [Detail](detail) is drawn, but neither queried nor collided with. Point and spot
//! lights' shadows come from one camera's mesh. [limits.md] has the whole list.
//!
//! # Where it comes from
//! Density maps: A. Cervin, *Adaptive Hardware-accelerated Terrain Tessellation*, 2012. Edge factors, detail
//! and the held eye: I. Cantlay, *DirectX 11 Terrain Tessellation*, 2011. Slopes from heights: J. Andersson,
//! *Terrain Rendering in Frostbite Using Procedural Shader Splatting*, 2007. Levels and morph: F. Strugar,
//! *Continuous Distance-Dependent Level of Detail for Rendering Heightmaps*, 2009. Items that follow one of
//! them name it, with the equation, figure or section where there is one.
//!
//! # Versions
//! | bevy_tessera | Bevy | Avian | bevy_egui | Rust |
//! |---|---|---|---|---|
//! | 0.1 | 0.19.1 | 0.7 | 0.42 | 1.95 |
//!
//! Licence: MIT or Apache 2.0, as you like.
//!
//! [Bevy]: https://bevy.org
#![cfg_attr(docsrs, feature(doc_cfg))]
#![deny(unsafe_code)]
#![warn(missing_docs)]
#![cfg_attr(
    not(all(feature = "render", feature = "archive")),
    expect(
        rustdoc::broken_intra_doc_links,
        reason = "this page names modules of all features; with all of them every link is checked"
    )
)]

#[cfg(feature = "archive")]
pub mod archive;
pub mod bake;
pub mod density;
pub mod detail;
pub mod edit;
pub mod error_bound;
pub mod lattice;
pub mod mesh_export;
pub mod query;
#[cfg(feature = "render")]
pub mod render;
pub mod residency;
#[cfg(all(feature = "ecs", feature = "archive"))]
pub mod source;
#[cfg(feature = "ecs")]
pub mod stream;
pub mod terrain;
pub mod tessellate;
pub mod tile;
#[cfg(feature = "ecs")]
pub mod view;

#[cfg(feature = "egui")]
pub mod debug;
#[cfg(feature = "gizmos")]
pub mod gizmos;
pub mod output;
#[cfg(feature = "avian")]
pub mod physics;
#[cfg(feature = "ecs")]
mod plugins;
#[cfg(feature = "remote")]
pub mod remote;
#[cfg(feature = "ecs")]
pub use plugins::TerrainPlugins;

/// The code in the README compiles.
#[cfg(all(doctest, feature = "render"))]
#[doc = include_str!("../README.md")]
struct Readme;

/// The code in the guides compiles.
#[cfg(all(doctest, feature = "render", feature = "archive"))]
mod guides {
    #[doc = include_str!("../docs/guides/bring-your-height-map.md")]
    struct BringYourHeightMap;

    #[doc = include_str!("../docs/guides/tune-for-your-gpu.md")]
    struct TuneForYourGpu;

    #[cfg(feature = "avian")]
    #[doc = include_str!("../docs/guides/destroy-things.md")]
    struct DestroyThings;

    #[cfg(feature = "remote")]
    #[doc = include_str!("../docs/guides/run-a-server.md")]
    struct RunAServer;

    #[cfg(all(feature = "egui", feature = "remote"))]
    #[doc = include_str!("../docs/guides/look-inside.md")]
    struct LookInside;

    #[doc = include_str!("../docs/guides/how-it-works.md")]
    struct HowItWorks;

    #[doc = include_str!("../docs/guides/limits.md")]
    struct Limits;
}
