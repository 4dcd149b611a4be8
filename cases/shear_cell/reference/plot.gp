# gnuplot plot.gp, in this folder: steady.png and start_ups.png from the tables of table.py
set datafile separator ","
set terminal pngcairo size 1000,420 font "Sans,11"
set key top left
set grid lc rgb "#dddddd"
set logscale x
set format x "10^{%L}"
set output "steady.png"
set multiplot layout 1,2
set xlabel "I"
set ylabel "mu"
plot "steady.csv" using "I":"mu":"I_se":"mu_se" with xyerrorbars pt 7 ps 0.7 lc rgb "#1f5fa8" title "core", \
     "steady.csv" using "I":"wall_mu" with points pt 6 ps 1.2 lc rgb "#c05020" title "wall"
set ylabel "phi"
set key bottom left
plot "steady.csv" using "I":"phi":"I_se":"phi_se" with xyerrorbars pt 7 ps 0.7 lc rgb "#1f5fa8" title "volume overlap"
unset multiplot
unset logscale x
set format x "%g"
set output "start_ups.png"
set multiplot layout 1,3
set xlabel "strain s"
set xrange [0:2]
pick(f) = sprintf("< grep -E '^start_up,%s,0,0.004,' transients.csv", f)
array frictions[3] = ["0", "0.1", "5"]
array names[3] = ["dense", "medium", "loose"]
array colours[3] = ["#1f5fa8", "#555555", "#c05020"]
set key top right
set ylabel "phi"
plot for [i=1:3] pick(frictions[i]) using 7:8:9 with yerrorbars pt 7 ps 0.4 lc rgb colours[i] title names[i]
set ylabel "beta"
plot for [i=1:3] pick(frictions[i]) using 7:10:11 with yerrorbars pt 7 ps 0.4 lc rgb colours[i] title names[i]
set ylabel "mu"
plot for [i=1:3] pick(frictions[i]) using 7:12:13 with yerrorbars pt 7 ps 0.4 lc rgb colours[i] title names[i]
unset multiplot
