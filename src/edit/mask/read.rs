//! Reading a mask; `shaders/destruction.wgsl` does the same, operation for operation.

use super::{DestructionMask, MASK_MIPS, MASK_PAGE_TEXELS, MIP_OFFSETS, MaskPlace, PAGE_LOG2};
use crate::edit::EDIT_UNITS;
use glam::{DVec2, IVec2, Vec2};

impl DestructionMask {
    /// How scorched the ground is, 0 to 1, at a place in metres of the terrain's own x and z, as a
    /// pixel sees it that covers `footprint_m` metres of ground; 0 reads the texels themselves.
    #[must_use]
    pub fn strength_at(&self, local_m: DVec2, footprint_m: f32) -> f32 {
        let units_per_m = f64::from(EDIT_UNITS) / self.spacing_m();
        let units = local_m * units_per_m;
        let whole = units.floor();
        let footprint = footprint_m * units_per_m as f32;
        self.strength(
            whole.as_ivec2().to_array(),
            (units - whole).as_vec2().to_array(),
            footprint,
        )
    }

    /// The same at a place in [`EDIT_UNITS`], whole and the fraction beyond it, for a pixel that
    /// is `footprint` units wide: bilinear, between the two mips whose texels are just narrower and just
    /// wider than the pixel; the greatest of all layers.
    #[must_use]
    pub fn strength(&self, whole: [i32; 2], fraction: [f32; 2], footprint: f32) -> f32 {
        let (whole, fraction) = (IVec2::from(whole), Vec2::from(fraction));
        let mut strength = 0.0_f32;
        let layers = self.layers();
        for layer in 0..u32::BITS - layers.leading_zeros() {
            if layers >> layer & 1 == 0 {
                continue;
            }
            let shift = self.shift + layer;
            let wide = footprint / (1_u32 << shift) as f32;
            let mip = wide.max(1.0).log2().min((MASK_MIPS - 1) as f32);
            let fine = mip.floor() as u32;
            let blend = mip - fine as f32;
            let mut here = self.mip_strength(layer as u8, fine, whole, fraction);
            if blend > 0.0 {
                let coarse = self.mip_strength(layer as u8, fine + 1, whole, fraction);
                here += (coarse - here) * blend;
            }
            strength = strength.max(here);
        }
        strength
    }

    /// One mip of a layer, bilinear.
    fn mip_strength(&self, layer: u8, mip: u32, whole: IVec2, fraction: Vec2) -> f32 {
        let shift = self.shift + u32::from(layer) + mip;
        let inside = (whole & IVec2::splat((1 << shift) - 1)).as_vec2();
        // Texels have their values in their middles.
        let mut between = (inside + fraction) / (1_u32 << shift) as f32 - 0.5;
        let mut texel = whole >> IVec2::splat(shift as i32);
        if between.x < 0.0 {
            between.x += 1.0;
            texel.x -= 1;
        }
        if between.y < 0.0 {
            between.y += 1.0;
            texel.y -= 1;
        }
        let at = |x: i32, z: i32| self.texel(layer, mip, texel + IVec2::new(x, z));
        let top = at(0, 0) + (at(1, 0) - at(0, 0)) * between.x;
        let bottom = at(0, 1) + (at(1, 1) - at(0, 1)) * between.x;
        top + (bottom - top) * between.y
    }

    /// A texel of a mip of a layer, 0 to 1; 0 where there is no page.
    fn texel(&self, layer: u8, mip: u32, texel: IVec2) -> f32 {
        let page_shift = IVec2::splat((PAGE_LOG2 - mip) as i32);
        let [x, z] = (texel >> page_shift).to_array();
        let Some(number) = self.table.find(MaskPlace { layer, x, z }) else {
            return 0.0;
        };
        let Some(Some(page)) = self.pages.get(number as usize) else {
            return 0.0;
        };
        let side = MASK_PAGE_TEXELS >> mip;
        let [x, z] = (texel & IVec2::splat(side as i32 - 1)).to_array();
        let value = page.texels[MIP_OFFSETS[mip as usize] + z as usize * side + x as usize];
        f32::from(value) / 255.0
    }
}
