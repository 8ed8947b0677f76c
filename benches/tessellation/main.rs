//! How many triangles a view takes and how far they lie from the finest heights, in pixels: with and
//! without the density map, by other policies, and beside what could be had at best.
//!
//! `cargo bench --no-default-features --bench tessellation [-- folder]`
//!
//! Prints tables, and writes them and a plot to `docs/figures` or to the given folder. Everything is
//! computed on the CPU, of the bundled terrain, all around the eye unless a table says otherwise. An
//! error is the height difference at a sample times the focal length over the distance, as if seen
//! from the side.

mod bintree;
mod check;
mod curves;
mod delaunay;
mod ground;
mod measure;
mod plot;
mod policy;
mod table;
mod tables;
mod widths;

use ground::Ground;
use std::path::{Path, PathBuf};
use std::time::Instant;

fn main() {
    let start = Instant::now();
    // Cargo adds an option of its own.
    let folder = std::env::args()
        .skip(1)
        .find(|argument| !argument.starts_with('-'))
        .map_or_else(
            || Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/figures"),
            PathBuf::from,
        );
    std::fs::create_dir_all(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let baked = tempfile::tempdir().expect("a temporary folder");
    let ground = Ground::bundled(&baked.path().join("terrain"));
    let done = |what: &str| eprintln!("{:6.1} s  {what}", start.elapsed().as_secs_f64());
    done("terrain baked");

    check::small();
    done("references checked");
    tables::saved(&ground, &folder);
    done("what the density map saves");
    let curves = curves::curves(&ground, &folder);
    plot::plot(&curves, &folder.join("tessellation.png"));
    done("curves and plot");
    tables::partitionings(&ground, &folder);
    done("partitionings");
    tables::sweep(&ground, &folder);
    done("faces a side and triangle width");
    tables::levels(&ground, &folder);
    done("what coarser levels leave out");
    widths::widths(&ground, &folder);
    done("triangles in a picture");
    tables::depth(&ground, &folder);
    done("depth of view");
}
