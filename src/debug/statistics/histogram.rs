//! Histograms of triangle sizes and of factors (Cantlay 2011, figure 22).

use bevy_egui::egui::{Color32, RichText, Ui};
use egui_plot::{Bar, BarChart, GridMark, LineStyle, Plot, PlotBounds, VLine};

/// Bins an octave.
const AN_OCTAVE: f64 = 4.0;
/// Where a pixel lies among the bins of triangle sizes.
const ONE_PX: f64 = 9.0;

/// What lies below the target, around it, and above.
const BELOW: Color32 = Color32::from_rgb(78, 154, 241);
const WITHIN: Color32 = Color32::from_rgb(89, 180, 84);
const ABOVE: Color32 = Color32::from_rgb(242, 142, 43);
const TARGET: Color32 = Color32::from_rgb(255, 66, 66);

/// Where a size lies among the bins, whose first ends at a quarter of a pixel.
pub(super) fn place_of(px: f64) -> f64 {
    AN_OCTAVE * px.log2() + ONE_PX
}

/// The size that a place among the bins stands for.
fn px_at(place: f64) -> f64 {
    ((place - ONE_PX) / AN_OCTAVE).exp2()
}

/// Parts of all triangles, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shares {
    pub(super) below: f64,
    /// From a quarter of an octave below the target to a quarter above.
    pub(super) within: f64,
    pub(super) above: f64,
}

impl Shares {
    /// The shares of triangles with sizes as counted in `bins`; `None` where there are none. A bin that
    /// a limit cuts is split as if its triangles lay evenly in it.
    pub(super) fn new(bins: &[u32], target_px: f64) -> Option<Self> {
        let total: f64 = bins.iter().copied().map(f64::from).sum();
        if total == 0.0 {
            return None;
        }
        let up_to = |place: f64| -> f64 {
            let bins = bins.iter().zip(0_u32..);
            bins.map(|(&count, bin)| f64::from(count) * (place - f64::from(bin)).clamp(0.0, 1.0))
                .sum()
        };
        let place = place_of(target_px);
        let (low, high) = (up_to(place - 1.0) / total, up_to(place + 1.0) / total);
        Some(Self {
            below: low,
            within: high - low,
            above: 1.0 - high,
        })
    }

    /// The shares in words.
    pub(super) fn words(&self) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        format!(
            "{} within ¼ octave of the target, {} smaller, {} larger",
            percent(self.within),
            percent(self.below),
            percent(self.above)
        )
    }
}

/// What a view's triangles are to be like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Target {
    /// The camera's triangle width; `None` under a policy that has none.
    pub(super) width_px: Option<f32>,
    /// What a budget multiplies it by.
    pub(super) width_scale: f32,
}

fn plot(id: &str) -> Plot<'_> {
    Plot::new(id)
        .height(150.0)
        .allow_drag(false)
        .allow_zoom(false)
        .allow_scroll(false)
        .allow_boxed_zoom(false)
        .allow_double_click_reset(false)
        .show_crosshair(false)
        .y_axis_min_width(36.0)
}

/// Marks at whole octaves, from the place `first` on.
fn octaves(first: u32, bins: usize) -> Vec<GridMark> {
    let places = (first..=bins as u32).step_by(4);
    places
        .map(|place| GridMark {
            value: f64::from(place),
            step_size: AN_OCTAVE,
        })
        .collect()
}

fn show_bars(
    ui: &mut Ui,
    plot: Plot,
    bins: &[u32],
    colour: impl Fn(f64) -> Color32,
    lines: Vec<VLine>,
) {
    let most = bins.iter().copied().max().unwrap_or(0).max(1);
    let bars = bins.iter().zip(0_u32..).filter(|(count, _)| **count > 0);
    let bars = bars
        .map(|(&count, bin)| {
            let middle = f64::from(bin) + 0.5;
            Bar::new(middle, f64::from(count))
                .width(0.92)
                .fill(colour(middle))
        })
        .collect();
    let end = bins.len() as f64;
    plot.show(ui, |plot| {
        plot.set_plot_bounds(PlotBounds::from_min_max(
            [0.0, 0.0],
            [end, 1.08 * f64::from(most)],
        ));
        plot.bar_chart(BarChart::new("triangles", bars).allow_hover(false));
        for line in lines {
            plot.vline(line);
        }
    });
}

/// Shows how long the triangles' longest edges are on the screen.
pub(super) fn show_sizes(ui: &mut Ui, sizes: &[u32; 32], target: Target) {
    let total: u64 = sizes.iter().copied().map(u64::from).sum();
    let aim_px = target
        .width_px
        .map(|width_px| f64::from(width_px * target.width_scale));
    ui.label(format!(
        "{} triangles measured",
        super::figures::grouped(total)
    ))
    .on_hover_text(
        "Triangles that are drawn, those without area left out. Each counts once, wherever it \
             lies and whatever hides it.",
    );
    let mut lines = Vec::new();
    let line = |name: String, px: f64| {
        VLine::new(name, place_of(px))
            .color(TARGET)
            .width(2.0)
            .allow_hover(false)
    };
    match target.width_px {
        Some(width_px) => {
            ui.label(
                RichText::new(format!("target {width_px:.1} px")).color(TARGET),
            )
            .on_hover_text(
                "TerrainCamera::triangle_width_px, the line in the plot. Longest edges of well-made \
                 triangles gather from there to half an octave above it, where the diagonals of \
                 squares lie.",
            );
            lines.push(line("target".to_owned(), f64::from(width_px)));
        }
        None => {
            ui.label("no target: the policy bounds the error, not the width");
        }
    }
    if let Some(aim_px) = aim_px
        && target.width_scale > 1.0
    {
        ui.label(format!(
            "widened to {aim_px:.1} px, because the view wants more than max_vertices"
        ));
        lines.push(line("widened".to_owned(), aim_px).style(LineStyle::dashed_dense()));
    }
    if let Some(shares) = aim_px.and_then(|aim_px| Shares::new(sizes, aim_px)) {
        ui.label(shares.words()).on_hover_text(
            "Of the bins that the limits cut a part is counted, as if their triangles lay evenly in \
             them.",
        );
    }
    let place = aim_px.map(place_of);
    let colour = |middle: f64| match place {
        Some(place) if middle < place - 1.0 => BELOW,
        Some(place) if middle > place + 1.0 => ABOVE,
        Some(_) => WITHIN,
        None => BELOW,
    };
    let plot = plot("terrain_triangle_sizes")
        .x_axis_label("longest edge, px")
        .x_grid_spacer(|_| octaves(1, 32))
        .x_axis_formatter(|mark, _| {
            let px = px_at(mark.value);
            if px < 1.0 {
                format!("{px:.2}").trim_end_matches('0').to_owned()
            } else {
                format!("{px:.0}")
            }
        });
    show_bars(ui, plot, sizes, colour, lines);
}

/// Shows how many segments edges of faces are cut into.
pub(super) fn show_factors(ui: &mut Ui, factors: &[u32; 28], max_factor: f32, clamped: u32) {
    let total: u64 = factors.iter().copied().map(u64::from).sum();
    ui.label(format!(
        "{} edges, {} cut by max_factor {max_factor:.0}",
        super::figures::grouped(total),
        super::figures::grouped(clamped.into())
    ))
    .on_hover_text(
        "Edges of faces, those inside a node from both sides. Many at the left end: faces are finer \
         than the triangles that are wanted, and cost for nothing; use fewer faces a side. Many at \
         the right end: triangles get larger than wanted; use more faces a side, or let max_factor \
         rise.",
    );
    // Quarters of an octave are even in the factor, not in its logarithm.
    let place = |factor: f64| {
        let octave = factor.log2().floor();
        AN_OCTAVE * octave + AN_OCTAVE * (factor / octave.exp2() - 1.0)
    };
    let most = VLine::new("max_factor", place(f64::from(max_factor.max(1.0))))
        .color(TARGET)
        .width(2.0)
        .allow_hover(false);
    let plot = plot("terrain_factors")
        .x_axis_label("factor: segments an edge")
        .x_grid_spacer(|_| octaves(0, 28))
        .x_axis_formatter(|mark, _| format!("{:.0}", (mark.value / AN_OCTAVE).exp2()));
    show_bars(ui, plot, factors, |_| BELOW, vec![most]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_those_of_the_bins_and_cut_bins_are_split() {
        let mut bins = [0; 32];
        assert_eq!(Shares::new(&bins, 6.0), None);
        // 4 px begin bin 17: ±¼ octave is from 16 to 18.
        bins[15] = 10;
        bins[16] = 20;
        bins[17] = 30;
        bins[18] = 40;
        let exact = Shares::new(&bins, 4.0).unwrap();
        assert_eq!(place_of(4.0), 17.0);
        assert!((exact.below - 0.1).abs() < 1e-9);
        assert!((exact.within - 0.5).abs() < 1e-9);
        assert!((exact.above - 0.4).abs() < 1e-9);
        let cut = Shares::new(&bins, px_at(17.5)).unwrap();
        assert!((cut.below - 0.2).abs() < 1e-9);
        assert!((cut.within - 0.6).abs() < 1e-9);
        assert_eq!(
            exact.words(),
            "50 % within ¼ octave of the target, 10 % smaller, 40 % larger"
        );
    }

    #[test]
    fn the_first_bin_ends_at_a_quarter_of_a_pixel() {
        assert_eq!(place_of(0.25), 1.0);
        assert_eq!(px_at(1.0), 0.25);
        assert_eq!(px_at(13.0), 2.0);
    }
}
