//! The brush's command as Rust code.

use super::tool::{BrushKind, TerrainBrush};
use crate::debug::form::code_of_f32;
use crate::edit::{Crater, Flatten, Raise, Smooth, Stamp, StampImage};
use bevy::math::Vec3;
use std::fmt::Write;

/// A chain of calls, a line each beyond the first.
struct Chain(String);

impl Chain {
    fn new(start: &str) -> Self {
        Self(start.to_owned())
    }

    fn call(&mut self, name: &str, values: &[String]) {
        // A String takes whatever is written to it.
        let _ = write!(self.0, "\n        .{name}({})", values.join(", "));
    }

    /// A call where the value isn't the builder's.
    fn number(&mut self, name: &str, value: f32, usual: f32) {
        if value != usual {
            self.call(name, &[code_of_f32(value)]);
        }
    }

    /// The whole, with a field that no call sets.
    fn finish(self, kind: &str, density: (f32, f32)) -> String {
        let Self(chain) = self;
        let (density, usual) = density;
        if density == usual {
            return format!("commands.trigger(\n    {chain},\n);");
        }
        let density = code_of_f32(density);
        let chain = chain.replace("\n    ", "\n        ");
        format!("commands.trigger({kind} {{\n    density_per_m: {density},\n    ..{chain}\n}});")
    }
}

impl TerrainBrush {
    /// What triggers an edit like the brush's at `point`; a stamp's image is called `image`.
    pub(super) fn code(&self) -> String {
        match self.kind {
            BrushKind::Crater => {
                let now = &self.crater;
                let usual = Crater::at(Vec3::ZERO).radius(now.radius_m);
                let mut chain = Chain::new("Crater::at(point)");
                chain.call("radius", &[code_of_f32(now.radius_m)]);
                chain.number("depth", now.depth_m, usual.depth_m);
                chain.number("rim", now.rim_m, usual.rim_m);
                chain.call(
                    "rough",
                    &[code_of_f32(now.roughness), self.seed.to_string()],
                );
                chain.number("scorched", now.scorch, usual.scorch);
                chain.finish("Crater", (now.density_per_m, usual.density_per_m))
            }
            BrushKind::Raise | BrushKind::Lower => {
                let lowers = self.kind == BrushKind::Lower;
                let now = if lowers { &self.lower } else { &self.raise };
                let usual = Raise::at(Vec3::ZERO);
                let mut chain = Chain::new("Raise::at(point)");
                chain.call("radius", &[code_of_f32(now.radius_m)]);
                chain.call("by", &[code_of_f32(now.by_m)]);
                chain.number("hard", now.hardness, usual.hardness);
                chain.finish("Raise", (now.density_per_m, usual.density_per_m))
            }
            BrushKind::Flatten => {
                let (now, usual) = (&self.flatten, Flatten::at(Vec3::ZERO));
                let mut chain = Chain::new("Flatten::at(point)");
                chain.call("radius", &[code_of_f32(now.radius_m)]);
                chain.number("strength", now.strength, usual.strength);
                chain.number("hard", now.hardness, usual.hardness);
                chain.finish("Flatten", (0.0, 0.0))
            }
            BrushKind::Smooth => {
                let (now, usual) = (&self.smooth, Smooth::at(Vec3::ZERO));
                let mut chain = Chain::new("Smooth::at(point)");
                chain.call("radius", &[code_of_f32(now.radius_m)]);
                chain.number("strength", now.strength, usual.strength);
                chain.number("hard", now.hardness, usual.hardness);
                chain.finish("Smooth", (0.0, 0.0))
            }
            BrushKind::Stamp => {
                let image = StampImage {
                    side: 0,
                    samples: [].into(),
                };
                let (now, usual) = (&self.stamp, Stamp::at(Vec3::ZERO, image));
                let mut chain = Chain::new("Stamp::at(point, image)");
                chain.call("side", &[code_of_f32(now.side_m)]);
                chain.call("by", &[code_of_f32(now.by_m)]);
                chain.number("turned", now.turn, usual.turn);
                chain.number("scorched", now.scorch, usual.scorch);
                chain.finish("Stamp", (now.density_per_m, usual.density_per_m))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn code_says_what_differs_from_the_builders() {
        let mut brush = TerrainBrush::default();
        brush.set_radius_m(6.0);
        assert_eq!(
            brush.code(),
            "commands.trigger(\n    Crater::at(point)\n        .radius(6.0)\n        .rough(0.3, 1),\n);"
        );
        brush.kind = BrushKind::Lower;
        brush.lower.radius_m = 2.5;
        brush.lower.by_m = -1.5;
        brush.lower.hardness = 0.75;
        brush.lower.density_per_m = 2.0;
        assert_eq!(
            brush.code(),
            "commands.trigger(Raise {\n    density_per_m: 2.0,\n    ..Raise::at(point)\n            \
             .radius(2.5)\n            .by(-1.5)\n            .hard(0.75)\n});"
        );
        for kind in BrushKind::ALL {
            brush.kind = kind;
            assert!(brush.code().starts_with("commands.trigger("), "{kind:?}");
        }
    }
}
