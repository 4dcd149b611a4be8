# gnuplot plot.gp, in this folder: steady.png and transients.png from the tables of table.py
set datafile separator ","
set terminal pngcairo size 1100,440 font "Sans,11"
set grid lc rgb "#dddddd"
set logscale x
set format x "10^{%L}"
set output "steady.png"
set multiplot layout 1,2
set xlabel "I"
set ylabel "mu"
set key top left
band(q) = sprintf("< grep '^%s,0' literature.csv", q)
plot band("mu") using 2:(0.5*($3+$4)):3:4 with yerrorbars pt 0 lw 6 lc rgb "#c8c8c8" title "published DEM, friction 0.5", \
     "friction_05_steady.csv" using "I":"mu":"I_se":"mu_se" with xyerrorbars pt 7 ps 0.7 lc rgb "#1f5fa8" title "core, 0.5", \
     "friction_05_steady.csv" using "I":"wall_mu" with points pt 6 ps 1.2 lc rgb "#1f5fa8" title "wall, 0.5", \
     "friction_03_steady.csv" using "I":"mu":"I_se":"mu_se" with xyerrorbars pt 7 ps 0.7 lc rgb "#c05020" title "core, 0.3", \
     "friction_03_steady.csv" using "I":"wall_mu" with points pt 6 ps 1.2 lc rgb "#c05020" title "wall, 0.3"
set ylabel "phi"
set key bottom left
plot band("phi") using 2:(0.5*($3+$4)):3:4 with yerrorbars pt 0 lw 6 lc rgb "#c8c8c8" title "published DEM, friction 0.5", \
     "friction_05_steady.csv" using "I":"phi":"I_se":"phi_se" with xyerrorbars pt 7 ps 0.7 lc rgb "#1f5fa8" title "0.5", \
     "friction_03_steady.csv" using "I":"phi":"I_se":"phi_se" with xyerrorbars pt 7 ps 0.7 lc rgb "#c05020" title "0.3"
unset multiplot
unset logscale x
set format x "%g"
set terminal pngcairo size 1200,1000 font "Sans,10"
set output "transients.png"
set multiplot layout 3,3
set xlabel "strain s"
set xrange [0:2.4]
table(what) = sprintf("< grep -E '^%s' friction_05_transients.csv", what)
array starts[3] = ["start_up,0,0,0.004,", "start_up,0.1,0,0.004,", "start_up,5,0,0.004,"]
array start_names[3] = ["dense", "medium", "loose"]
array jumps[4] = ["jump,0.5,0.005,0.015,", "jump,0.5,0.015,0.005,", "jump,0.5,0.02,0.1,", "jump,0.5,0.1,0.02,"]
array jump_names[4] = ["I 0.005 to 0.015", "0.015 to 0.005", "0.02 to 0.1", "0.1 to 0.02"]
array others[2] = ["reversal,", "pressure_jump,"]
array other_names[2] = ["reversal, I 0.015", "P 1 to 4 kPa"]
array colours[4] = ["#1f5fa8", "#555555", "#c05020", "#3a9a50"]
array columns[3] = [8, 10, 12]
array quantities[3] = ["phi", "beta", "mu"]
do for [q=1:3] {
  set ylabel quantities[q]
  set key top right
  c = columns[q]
  if (q == 1) { set title "start-up, I = 0.004" } else { set title "" }
  plot for [i=1:3] table(starts[i]) using 7:c:c+1 with yerrorbars pt 7 ps 0.4 lc rgb colours[i] title start_names[i]
  if (q == 1) { set title "jump of the rate"; set yrange [0.568:0.605] }
  if (q == 2) { set yrange [-0.35:0.25] }
  plot for [i=1:4] table(jumps[i]) using 7:c:c+1 with yerrorbars pt 7 ps 0.4 lc rgb colours[i] title jump_names[i]
  set autoscale y
  if (q == 1) { set title "reversal, jump of the pressure"; set yrange [0.587:0.61] }
  if (q == 3) { set key bottom right }
  plot for [i=1:2] table(others[i]) using 7:c:c+1 with yerrorbars pt 7 ps 0.4 lc rgb colours[i] title other_names[i]
  set autoscale y
}
unset multiplot
